"""What the pages of docs/ say is run: their Python lines, their commands, their models, their tables, their links."""

import json
import re
import shlex
import subprocess
import tomllib
from functools import cache
from pathlib import Path, PurePosixPath

import pytest
from doc_tables import TABLE, TABLES, TRIED, settled, words, written
from pages import DOCS, PAGES, README, ROOT, blocks, everywhere, shown, text
from pinned import differing
from typer.testing import CliRunner

import hgogen as hg
from hgogen.commands.app import _FILES as COMMANDS
from hgogen.commands.app import app, command_of
from hgogen.commands.library import answers
from hgogen.model import load
from hgogen.modelfiles import declarations, tuning
from hgogen.modelfiles.place import shipped
from hgogen.reading import text_model
from hgogen.reading.text_model import entry
from hgogen.run import native
from hgogen.stepping.guards import STEP_BITS

CHECKS = shown("hgogen check models/")


# --- Python -----------------------------------------------------------------------------------------------------


CASES = {  # pages that show files of tests/fixtures/, which are run where they belong, in a copy of the project
    "contributing": ("observers/luenberger.py", "tests/test_luenberger.py"),
    "new_proof": ("recheck/rules/below_lipschitz.py",),
}
HOWTOS = [page for page in PAGES if page.startswith("howto/") and page != "howto/index"]
PYTHON = [page for page in PAGES if page not in (*CASES, *HOWTOS) and blocks("python", text(page))]


@pytest.mark.ordinary("python", "tuning")
@pytest.mark.parametrize("page", PYTHON)
def test_the_python_lines_run(page: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """After those of the README, whose names they use."""
    monkeypatch.chdir(tmp_path)
    lines = "".join(blocks("python", README.read_text()) + blocks("python", text(page)))
    exec(compile(lines, f"{page}.md", "exec"), {})


def test_pages_with_python_are_there() -> None:
    """So that the test above cannot pass on nothing."""
    assert {"logs", "proofs", "python"} <= set(PYTHON)
    assert len(HOWTOS) > 25


@pytest.mark.ordinary("howto/missing_samples", "howto/casadi")
@pytest.mark.parametrize("page", HOWTOS)
def test_a_how_to_prints_what_it_shows(
    page: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """It runs alone, as a reader copies it; below the lines of Python stands what they print."""
    monkeypatch.chdir(tmp_path)
    exec(compile("".join(blocks("python", text(page))), f"{page}.md", "exec"), {})
    assert capsys.readouterr().out == "".join(blocks("text", text(page)))


@pytest.mark.parametrize("page", HOWTOS)
def test_a_how_to_is_one_question(page: str) -> None:
    """It is short, and has something to run with what it prints."""
    title, *_ = text(page).splitlines()
    assert title.endswith("?")
    assert len(text(page).splitlines()) <= 60
    assert blocks("python", text(page)) or shown("hgogen", text(page))
    lines = [line for block in blocks("python", text(page)) for line in block.splitlines()]
    assert [line for line in lines if len(line) > 105] == []  # the width of a page of the site


@pytest.mark.full
@pytest.mark.parametrize("page", [page for page in HOWTOS if shown("hgogen generate", text(page))])
def test_a_how_to_writes_what_it_shows(page: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    for line, wanted in shown("hgogen generate", text(page)):
        assert wanted
        result = CliRunner().invoke(app, shlex.split(line)[1:])
        assert result.exit_code == 0, result.output
        assert [row for row in wanted.splitlines() if row not in result.stdout.splitlines()] == []


@pytest.mark.parametrize("page", CASES)
def test_the_cases_shown_are_those_that_are_run(page: str) -> None:
    assert blocks("python", text(page)) == [(ROOT / "tests/fixtures" / path).read_text() for path in CASES[page]]


def test_contributing_is_short() -> None:
    """So that it is read: 70 lines beside the case that it shows."""
    assert len(re.sub(r"```.*?```", "", text("contributing"), flags=re.DOTALL).splitlines()) <= 70


@pytest.mark.parametrize("name", re.findall(r"`hg\.([\w.]+)", " ".join(everywhere().values())))
def test_what_is_named_is_there(name: str) -> None:
    value: object = hg
    for part in name.strip(".").split("."):
        value = getattr(value, part)


# --- commands ---------------------------------------------------------------------------------------------------


def test_checks_are_shown() -> None:
    """So that the test of what they print cannot pass on nothing."""
    assert len(CHECKS) >= 4


@pytest.mark.ordinary("hgogen check models/duffing.toml", "hgogen check models/sir.toml")
@pytest.mark.parametrize(("line", "wanted"), CHECKS, ids=[line for line, _ in CHECKS])
def test_the_checks_print_what_is_shown(line: str, wanted: str, monkeypatch: pytest.MonkeyPatch) -> None:
    assert wanted
    assert missing(line, wanted, monkeypatch) == []


@pytest.mark.full
def test_the_comparison_prints_what_is_shown(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    if native.compiler() is None:
        pytest.skip("no C compiler")
    ((line, wanted),) = shown("hgogen compare models/")
    assert len(wanted.splitlines()) > 10
    assert missing(line, wanted, monkeypatch, "-o", str(tmp_path)) == []


@pytest.mark.full
def test_a_certificate_is_verified_as_shown(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    ((write, nothing),) = shown("hgogen check pendulum")
    ((line, wanted),) = shown("hgogen recheck")
    assert not nothing
    assert missing(write.replace("pendulum.json", str(tmp_path / "pendulum.json")), "", monkeypatch) == []
    assert missing(line.replace("pendulum.json", str(tmp_path / "pendulum.json")), wanted, monkeypatch) == []


def missing(line: str, wanted: str, monkeypatch: pytest.MonkeyPatch, *more: str) -> list[str]:
    """The lines that a command is shown to print and does not."""
    monkeypatch.chdir(ROOT)
    monkeypatch.setenv("COLUMNS", "200")
    result = CliRunner().invoke(app, [*shlex.split(line)[1:], *more])
    assert result.exit_code == 0, result.output
    printed = [row.rstrip() for row in result.stdout.splitlines()]
    return [row for row in wanted.splitlines() if row not in printed]


def test_the_cc_line_works(tmp_path: Path) -> None:
    if native.compiler() is None:
        pytest.skip("no C compiler")
    ((line, wanted),) = shown("cc ")
    compiled, _, run = line.partition(" && ")
    assert run == "./check"
    command = compiled.replace("-o check", f"-o {tmp_path / 'check'}").replace("cc ", f"{native.compiler()} ", 1)
    subprocess.run(command, shell=True, cwd=ROOT, check=True)
    assert subprocess.run([tmp_path / "check"], capture_output=True, text=True, check=True).stdout == wanted


def test_commands_are_those_there_are() -> None:
    assert set(re.findall(r"^\| `hgogen (\w+)", text("command_line"), re.MULTILINE)) == set(COMMANDS)


def test_every_command_that_writes_files_says_where() -> None:
    """Each with --out has a row of "Where files go"."""
    rows = text("command_line").split("## Where files go")[1].split("\n\n")[1]
    writers = [name for name in COMMANDS if any("--out" in option.opts for option in command_of(name).params)]
    assert sorted(re.findall(r"`(\w+)`", "".join(row.split("|")[1] for row in rows.splitlines()))) == sorted(writers)


@cache
def described(command: str) -> str:
    return CliRunner().invoke(app, [command, "--help"], env={"COLUMNS": "200"}).stdout


LINES = sorted({line for one in everywhere().values() for line in re.findall(r"hgogen (\w+[^`\n]*)", one)})
CALLS = [line for line in LINES if line.split()[0] in COMMANDS]


def test_every_option_is_described() -> None:
    """Wherever a command is written with an option, its help has it."""
    assert len(CALLS) > 30
    options = {(line.split()[0], option) for line in CALLS for option in re.findall(r"(?<= )-[-a-z]+", line)}
    assert len(options) > 15
    assert [(command, option) for command, option in options if option not in described(command)] == []


# --- models -----------------------------------------------------------------------------------------------------


def test_the_json_is_a_model_of_a_library() -> None:
    (one,) = blocks("json", text("plain_text"))
    answer = dict(answers(entry(json.loads(one))))
    assert (answer["triangular"], answer["bounds"]) == (True, [[0, 1]])


@pytest.mark.full
@pytest.mark.usefixtures("undrawn")
def test_the_plain_text_model_is_generated(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "oscillator.toml").write_text(blocks("toml", text("plain_text"))[0])
    assert CliRunner().invoke(app, ["generate", "oscillator.toml"]).exit_code == 0
    assert (tmp_path / "generated" / "oscillator" / "oscillator.c").is_file()
    assert "oscillator.toml has no trial" in CliRunner().invoke(app, ["build", "oscillator.toml"]).stderr


def test_the_tunings_in_plain_text_are_observers(tmp_path: Path) -> None:
    model, tunings, points, grid = blocks("toml", text("plain_text"))
    (tmp_path / "oscillator.toml").write_text(model + tunings)
    cell = 'name = "cell"\n[states.soc]\nlow = 0.1\nhigh = 0.9\nflow = "-i"\n[inputs.i]\n[parameters.R]\nvalue = 1\n'
    (tmp_path / "cell.toml").write_text(cell + points)
    assert str(load(tmp_path / "cell.toml").plant.output[0]) == "-R*i + ocv(soc)"
    cart = 'name = "cart"\n[inputs.u]\n[inputs.T]\n[outputs.y]\nequation = "v"\n'
    (tmp_path / "cart.toml").write_text(cart + grid)
    assert str(load(tmp_path / "cart.toml").plant.flow[0]) == "u - friction(v, T)"
    loaded = load(tmp_path / "oscillator.toml")
    assert [loaded.step(name).observer.name for name in ("high_gain", "quiet")] == ["high_gain", "filtered"]


def test_every_key_of_a_plain_text_model_is_listed() -> None:
    """And no key that is none, but for the arguments of observers and of dissipation, which other tests ask."""
    rows = re.findall(r"^\| (at the top|`\w+(?:\.NAME)?`) \| (.*) \|$", text("plain_text"), re.MULTILINE)
    listed = {name.strip("`").removesuffix(".NAME"): re.findall(r"`(\w+)`", keys) for name, keys in rows}
    signals = {kind: keys for kind, (keys, _) in text_model.KINDS.items()}
    assert set(listed) == {"at the top", *(key for key, kind in text_model.TOP.items() if kind == text_model.TABLE)}
    assert {kind: set(listed[kind]) for kind in signals} == {kind: set(keys) for kind, keys in signals.items()}
    assert set(listed["tables"]) == set(text_model.POINTS)
    assert set(listed["trial"]) == set(declarations._TRIAL)
    assert set(listed["observer"]) == set(tuning.PLACED) - {"member"}
    assert set(listed["at the top"]) == set(text_model.TOP) - set(listed)


def test_every_key_of_a_certificate_is_listed() -> None:
    form = hg.forms.triangular(load(ROOT / "models" / "pendulum.py").plant)
    certificate = hg.certificate(form, form.checks)
    listed = re.findall(r"`(\w+)`", " ".join(re.findall(r"^\| (`.*?`) \|", text("certificates"), re.MULTILINE)))
    assert listed == list(certificate)
    assert f"The format has the version {certificate['version']}." in text("certificates")
    (about,) = re.findall(r"^\| `plant` \| (.*) \|$", text("certificates"), re.MULTILINE)
    assert {*certificate["plant"], "low", "high"} == set(re.findall(r"`(\w+)`", about))
    (about,) = re.findall(r"^\| `form` \| (.*) \|$", text("certificates"), re.MULTILINE)
    assert set(certificate["form"]) == set(re.findall(r"`(\w+)`", about))


def test_what_is_to_be_generated_anew_is_what_is_there() -> None:
    (names,) = re.findall(r"`hgogen generate ((?:\w+ )+\w+)`", text("contributing"))
    assert names.split() == sorted(path.name for path in (ROOT / "generated").iterdir() if path.is_dir())


# --- tables -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("page", PAGES)
def test_the_tables_are_those_there_are(page: str) -> None:
    """Each observer with its cost for the pendulum, the forms, the methods, the folders."""
    same = written(text(page)) == text(page)
    assert same, f"out of date: python tests/doc_tables.py writes the tables anew; {differing()}"


def test_the_table_of_observers_is_complete() -> None:
    tables = {name: words(rows) for page in PAGES for name, rows in TABLE.findall(text(page))}
    assert set(tables) == {*TABLES, *TRIED}
    assert set(hg.observers.__all__) == set(tables["observers"]) - {"observer", "---|---|---|---|---"}


STARTING = words(dict(TABLE.findall(text("tuning")))["starting"])


@pytest.mark.slow
@pytest.mark.parametrize("model", sorted(shipped().keys() & STARTING.keys()))
def test_with_starting_gains_settles_what_is_said(model: str) -> None:
    assert list(settled(model)) == STARTING[model], "python tests/doc_tables.py --trials writes the table anew"


def test_a_new_observer_gets_a_row_and_the_order_of_others_stays() -> None:
    lines = text("observers").splitlines(keepends=True)
    without = "".join(line for line in lines if not line.startswith("| `cascade` |"))
    anew = written(without.replace("332 + 4", "1 + 1"))
    assert re.search(r"^\| `cascade` \| there is no model .* \| \d+ \+ 0 \|$", anew, re.MULTILINE)
    assert anew.index("| `cascade` |") > anew.index("| `bank` |")
    assert "| 332 + 4 |" in anew


BIT = re.compile(r'\bBit\(\s*"([A-Z_]+)"')  # those of observers and parts: no one header has them all


def test_every_status_bit_is_explained() -> None:
    header = (ROOT / "generated/fitzhugh_nagumo/fitzhugh_nagumo.h").read_text()
    numbers = re.findall(r"#define FITZHUGH_NAGUMO_(\w+) +0x([0-9A-F]+)u", header)
    bits = [name for name, number in numbers if int(number, 16).bit_count() == 1]  # the mark of a state has more
    assert len(bits) >= 9
    others = [name for path in ROOT.glob("hgogen/**/*.py") for name in BIT.findall(path.read_text())]
    assert {"GAIN_LIMITED", "COVARIANCE_RESTARTED", "COVARIANCE_LIMITED"} <= set(others)
    for bit in [*bits, *others, *STEP_BITS]:
        assert f"| `{bit}` |" in text("firmware")


# --- links ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("page", [*everywhere(), "CONTRIBUTING.md", "CHANGELOG.md"])
def test_links_and_paths_lead_somewhere(page: str) -> None:
    said = (ROOT / page).read_text()
    folder = (ROOT / page).parent
    for link, anchor in re.findall(r"\]\((?!https:)([^)#]*)(?:#([^)]+))?\)", said):
        target = (folder / link) if link else ROOT / page
        assert target.exists(), link
        titles = re.findall(r"^#+ (.*)$", target.read_text(), re.MULTILINE) if anchor else []
        assert not anchor or anchor in {re.sub(r"[^\w-]", "", title.lower().replace(" ", "-")) for title in titles}
    paths = re.findall(r"`(?:python )?((?:hgogen|models|tests|docs|generated|\.ci)/[\w./]*)", said)
    assert [path for path in paths if not (ROOT / path).exists()] == []


def below(page: str) -> list[str]:
    """The pages in the toctrees of a page, by their paths below docs/, but for generated ones."""
    trees = re.findall(r"^```\{toctree\}$(.*?)^```$", (DOCS / f"{page}.md").read_text(), re.MULTILINE | re.DOTALL)
    listed = [line for tree in trees for line in tree.splitlines() if re.fullmatch(r"[\w/]+", line)]
    return [(PurePosixPath(page).parent / line).as_posix() for line in listed if not line.startswith("pages/")]


def test_the_navigation_has_every_page() -> None:
    """Each is in the toctree of one page that is reached from the first; the README has the pages of the first."""
    reached = [page := "index"]
    for page in reached:
        reached += below(page)
    written = [path.relative_to(DOCS).with_suffix("").as_posix() for path in DOCS.rglob("*.md")]
    assert sorted(reached) == sorted(page for page in written if not page.startswith("pages/"))
    assert set(re.findall(r"\(docs/([\w/]+)\.md\)", README.read_text())) >= set(below("index"))


# --- the version ------------------------------------------------------------------------------------------------


def test_the_version_is_the_same_everywhere() -> None:
    version = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["version"]
    assert f"\nversion: {version}\n" in (ROOT / "CITATION.cff").read_text()
    first, *_ = re.findall(r"^## (\S+) - ", (ROOT / "CHANGELOG.md").read_text(), re.MULTILINE)
    assert first in (version, "Unreleased")
