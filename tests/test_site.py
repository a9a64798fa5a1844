"""The pages that the site generates from the package; the site itself is built with warnings as errors by .ci/run."""

import html
import importlib.util
import inspect
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path
from types import ModuleType
from urllib.parse import quote

import pytest
from pages import ROOT

import hgogen as hg
from hgogen.commands.app import known

CASES = [(kind, name) for kind in ("observers", "forms", "methods") for name in getattr(hg, kind).__all__]


@pytest.fixture(scope="module")
def site() -> ModuleType:
    path = ROOT / "docs" / "site_pages.py"
    spec = importlib.util.spec_from_file_location("site_pages", path)
    assert spec is not None
    assert spec.loader is not None
    module = sys.modules["site_pages"] = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_an_equation_has_its_rows(site: ModuleType) -> None:
    aligned = "\\begin{aligned}\na &= b \\\\\nc &= d\n\\end{aligned}"
    assert [row.strip() for row in site.rows(aligned)] == ["a &= b", "c &= d"]
    matrix = "\\left[\\begin{matrix}0 & 1\\\\0 & 0\\end{matrix}\\right]"
    assert site.rows(matrix) == [matrix]


def test_equations_are_numbered(site: ModuleType) -> None:
    assert site.numbered("$$\na = b\n$$\n\nand\n\n$$\nc\n$$", "riccati") == (
        "$$\na = b\n$$ (riccati-1)\n\nand\n\n$$\nc\n$$ (riccati-2)"
    )


@pytest.mark.parametrize("name", hg.observers.__all__)
def test_each_observer_says_when_to_take_it(site: ModuleType, name: str) -> None:
    first, _, second = site.when(name)
    assert len(first) > len("**Use it if** .")
    assert len(second) > len("**What it requires, and what is proved:** .")


@pytest.mark.full
def test_an_observer_has_its_equations_figure_cost_and_claims(site: ModuleType) -> None:
    text, figure = site.example("riccati")
    parts = (
        "$$",
        r"\dot{S}",
        "![riccati on pendulum](riccati.svg)",
        "operations",
        "| `Q[0]` |",
        "`riccati.convergence`",
    )
    assert [part for part in parts if part not in text] == []
    assert figure.lstrip().startswith(b"<?xml")


def test_every_public_name_and_every_command_has_a_section(site: ModuleType) -> None:
    (interface,) = (text for _, text in site.interface())
    modules = {name for name in hg.__all__ if isinstance(getattr(hg, name), ModuleType)}
    sections = {line[len("## hg.") :] for line in interface.splitlines() if line.startswith("## hg.")}
    assert sections == set(hg.__all__) - modules
    (commands,) = (text for _, text in site.commands())
    listed = [line[len("## hgogen ") :] for line in commands.splitlines() if line.startswith("## hgogen ")]
    assert listed == known()
    assert "| `model` |" in commands


def test_a_page_cites_the_papers_of_its_docstring(site: ModuleType) -> None:
    """By all authors and the year, which may be those of a shorter list; a paper of one of them is another one."""
    cited = {name: " ".join(site.cited(getattr(hg.observers, name))) for name in hg.observers.__all__}
    assert [name for name, text in cited.items() if "{cite:t}" not in text] == []
    assert cited["riccati"].endswith("{cite:t}`boizot_busvelle_gauthier_2010` ")
    assert "`boizot_2010`" in " ".join(site.cited(hg.forms.block_triangular))
    assert site.cited(hg.methods.euler) == []


def test_the_bibliography_has_what_cases_cite(site: ModuleType) -> None:
    """And nothing else, with the titles as docstrings write them."""
    texts = [inspect.getdoc(getattr(getattr(hg, kind), name)) or "" for kind, name in CASES]
    keys = {
        key
        for kind, name in CASES
        for key in re.findall("`(.*?)`", " ".join(site.cited(getattr(getattr(hg, kind), name))))
    }
    assert keys == {key for key, _, _ in site.papers()}
    titles = re.findall(r" title = {(.*)},", (ROOT / "docs" / "references.bib").read_text())
    said = " ".join(" ".join(texts).split()).lower()
    assert len([title for title in titles if title.lower() in said]) >= len(titles) - 2  # by their journals


def test_a_signature_is_short(site: ModuleType) -> None:
    """Types without modules, a long one a parameter a line, and no memory address."""
    line = "```python\nhg.forms.triangular(plant: System, *, measured: bool = False) -> Form\n```\n"
    assert site.signature("hg.forms.triangular", hg.forms.triangular) == line
    fit = site.signature("hg.fit", hg.fit)
    assert "    *records: Log,\n    free: Iterable[str | Signal] | None = None,\n" in fit
    assert "    each: Callable[[Progress], None] = ...,\n" in fit
    assert "    *,\n    theta: float,\n" in site.signature("high_gain", hg.observers.high_gain)
    every = [site.signature(name, getattr(hg, name)) for name in hg.__all__]
    assert [one for one in every if " at 0x" in one or "hgogen." in one.partition("(")[2]] == []


# --- the search -------------------------------------------------------------------------------------------------


BROWSER = shutil.which("chromium") or shutil.which("google-chrome")


@pytest.fixture(scope="module")
def built(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The site that HGOGEN_SITE names, else one that is built here, whose cells do not run."""
    if done := os.environ.get("HGOGEN_SITE"):
        return Path(done).resolve()
    pytest.importorskip("myst_nb")
    folder = tmp_path_factory.mktemp("project")
    shutil.copytree(ROOT / "docs", folder / "docs")
    for name in ("hgogen", "models", "generated"):
        (folder / name).symlink_to(ROOT / name)
    command = ("-m", "sphinx", "-q", "-D", "nb_execution_mode=off", "-b", "html", "docs", "site")
    subprocess.run([sys.executable, *command], cwd=folder, check=True)
    return folder / "site"


def answers(site: Path, question: str) -> list[str]:
    """The pages that the site's own search answers with, read from disk, the first one first."""
    options = ("--headless", "--no-sandbox", "--disable-gpu", "--virtual-time-budget=15000", "--dump-dom")
    address = f"{(site / 'search.html').as_uri()}?q={quote(question)}"
    done = subprocess.run([str(BROWSER), *options, address], capture_output=True, text=True, timeout=120, check=True)
    results = done.stdout.partition('id="search-results"')[2]
    return [html.unescape(link) for link in re.findall(r'<li[^>]*><a href="([^"#?]*)', results)]


@pytest.mark.skipif(BROWSER is None, reason="no chromium")
@pytest.mark.full
@pytest.mark.parametrize(
    ("question", "page"),
    {
        "kalman filter": "kalman_filter",
        "EKF": "kalman_filter",
        "missing samples": "missing_samples",
        "wrap": "angle_wraps",
        "how to choose Q": "choose_q_r",
        "R units": "noise_units",
        "variable dt": "variable_dt",
        "outlier": "outliers",
        "Arduino": "arduino",
        "late camera": "late_sensor",
        "CasADi model": "casadi",
    }.items(),
)
def test_the_search_answers_with_the_right_page_first(built: Path, question: str, page: str) -> None:
    first, *_ = answers(built, question)
    assert first == f"howto/{page}.html"


def test_the_frame_of_the_home_page_does_not_move_it() -> None:
    """A fragment in the address of a frame scrolls the page around it, too; its page reads `?live` instead."""
    (address,) = re.findall(r'<iframe class="live" src="(.*?)"', (ROOT / "docs" / "index.md").read_text())
    assert address == "reports/fitzhugh_nagumo.html?live"
    assert 'location.search === "?live"' in (ROOT / "hgogen/extras/report/live.js").read_text()
