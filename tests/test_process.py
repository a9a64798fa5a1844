"""The command as a process: Ctrl-C, readers that stop, models that end Python or print, input without an end."""

import json
import os
import signal
import socket
import subprocess
import sys
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner

from hgogen import cli
from hgogen.commands import output, trial_runs
from hgogen.commands.output import json_text
from hgogen.reading.files import Unread, content_of
from hgogen.recheck import verification as recheck
from hgogen.run.consistency import OutputConsistency, Whiteness

COMMAND = [sys.executable, "-c", "from hgogen.cli import main; main()"]
PENDULUM, NEURON = (
    Path(__file__).resolve().parents[1] / "models" / f"{name}.py" for name in ("pendulum", "fitzhugh_nagumo")
)
posix = pytest.mark.skipif(os.name != "posix", reason="pipes and signals of POSIX")


def hgogen(*arguments: Any, status: int = 0) -> tuple[str, str]:
    result = CliRunner().invoke(cli.app, list(map(str, arguments)))  # type: ignore[attr-defined]
    assert result.exit_code == status, (result.stdout, result.stderr, result.exception)
    assert "Traceback" not in result.stdout + result.stderr
    return result.stdout, result.stderr


@pytest.fixture
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    return tmp_path


# --- Ctrl-C -------------------------------------------------------------------------------------------------


@posix
@pytest.mark.parametrize("moment", ["importing", "running", "lost"])
def test_ctrl_c_ends_it_by_the_signal_and_without_a_word_of_pythons(moment: str, here: Path) -> None:
    """While it imports nothing is to be put in order; later it says that it was interrupted, also where a library made
    another error of it, as CasADi does of what is raised within DM.__array__."""
    lines = [
        "import time",
        "try:",
        "    print('begun', flush=True)",
        "    time.sleep(999)",
        "except KeyboardInterrupt:",
    ]
    lines += ["    raise SystemError('a result with an exception set')" if moment == "lost" else "    raise"]
    (here / "slow.py").write_text("\n".join(lines))
    importing = "import sys; sys.modules['typer'] = None; import hgogen.cli as c, os, signal as s\n"
    importing += "class Late:\n    def find_spec(self, name, path, target=None):\n"
    importing += "        if name == 'hgogen.commands.app': os.kill(os.getpid(), s.SIGINT)\n"
    importing += "sys.meta_path.insert(0, Late()); c.main()"
    command = [sys.executable, "-c", importing] if moment == "importing" else [*COMMAND, "check", "slow.py"]
    heard = partial(signal.signal, signal.SIGINT, signal.SIG_DFL)  # which a shell's background job inherits as ignored
    pipes: dict[str, Any] = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
    with subprocess.Popen(command, preexec_fn=heard, **pipes) as run:
        said = ""
        if moment != "importing":
            said = run.stderr.readline()  # type: ignore[union-attr]
            run.send_signal(signal.SIGINT)
        out, err = run.communicate(timeout=900)
    assert run.returncode == -signal.SIGINT
    assert (out, said + err) == ("", "" if moment == "importing" else "begun\nhgogen: interrupted\n")


@pytest.mark.ordinary(
    "file-raise KeyboardInterrupt-raises KeyboardInterrupt, which ends Python",
    "file-raise GeneratorExit('now')-raises GeneratorExit (now), which",
    "file-import sys; sys.exit(3)-raises SystemExit (3), which ends Python; leave it out, or raise an error",
    "file-raise type('Odd', (BaseException,), {})-raises Odd, which ends Python",
    "file-raise type('Mute', (BaseException,), {'__str__': lambda e: 1/0})-raises Mute, which ends Python",
    "file-raise type('Mute', (ValueError,), {'__str__': lambda e: 1/0})-Mute",
    "step-raise type('Mute', (BaseException,), {'__str__': lambda e: 1/0})-raises Mute, which ends Python",
)
@pytest.mark.parametrize(
    ("line", "said"),
    [
        ("raise KeyboardInterrupt", "raises KeyboardInterrupt, which ends Python"),
        ("raise GeneratorExit('now')", "raises GeneratorExit (now), which"),
        ("import sys; sys.exit(3)", "raises SystemExit (3), which ends Python; leave it out, or raise an error"),
        ("raise type('Odd', (BaseException,), {})", "raises Odd, which ends Python"),
        ("raise type('Mute', (BaseException,), {'__str__': lambda e: 1/0})", "raises Mute, which ends Python"),
        ("raise type('Mute', (ValueError,), {'__str__': lambda e: 1/0})", "Mute"),
    ],
)
@pytest.mark.parametrize("place", ["file", "step"])
def test_a_model_that_ends_python(line: str, said: str, place: str, here: Path) -> None:
    text = PENDULUM.read_text()
    (here / "ends.py").write_text((f"{line}\n" if place == "file" else "") + f"{text}\ndef step():\n    {line}\n")
    _, err = hgogen("check", "ends.py", "--json", status=2)
    assert err.startswith("hgogen: ends.py, line ")
    assert said in err
    assert err.count("\n") == 1


# --- the standard output --------------------------------------------------------------------------------------


@pytest.mark.full
@posix
def test_nothing_but_results_reaches_the_standard_output(here: Path) -> None:
    """Descriptor 1, C's buffered stdout, a process, Python's own stream: all of them write to the error stream."""
    loud = """import ctypes, os, sys, warnings
os.write(1, b"by descriptor\\n"); ctypes.CDLL(None).puts(b"by C"); os.system("echo by a process")
sys.__stdout__.write("by Python\\n"); print("by print"); warnings.warn("be\\ncareful")
"""
    (here / "loud.py").write_text(loud + NEURON.read_text())  # of which nothing is proved that takes a solver
    done = subprocess.run([*COMMAND, "check", "loud.py", "--json"], capture_output=True, text=True, check=True)
    assert json.loads(done.stdout)["plant"] == "fitzhugh_nagumo"
    for how in ("by descriptor", "by C", "by a process", "by Python", "by print", "hgogen: be careful"):
        assert f"{how}\n" in done.stderr
    assert "Warning" not in done.stderr


@posix
def test_a_reader_of_the_help_that_stops_early_ends_it_quietly() -> None:
    reader, writer = os.pipe()
    os.close(reader)
    done = subprocess.run([*COMMAND, "--help"], stdout=writer, stderr=subprocess.PIPE, text=True, check=False)
    os.close(writer)
    assert done.stderr == ""
    assert done.returncode in (1, output.UNREAD)


def test_json_has_no_number_that_is_not_finite() -> None:
    value = {"a": [float("inf"), (-float("inf"), 1.5)], "b": {"c": float("nan")}, "d": np.float64("nan"), "e": "inf"}
    assert json.loads(json_text(value)) == {"a": [None, [None, 1.5]], "b": {"c": None}, "d": None, "e": "inf"}


def test_json_of_a_value_is_of_its_fields_or_what_it_says_of_itself() -> None:
    test = Whiteness(statistic=1.0, limit=2.0, lags=3)
    rows = [OutputConsistency("y", 5, 0.1, None, None, float("nan"), test)]
    (row,) = json.loads(json_text({"rows": rows}))["rows"]
    assert row["output"] == "y"
    assert row["outside"] is None
    assert row["whiteness"] == {"test": "Ljung-Box", "statistic": 1.0, "limit": 2.0, "lags": 3, "white": True}


@pytest.mark.full
@pytest.mark.parametrize("huge", ["1e300", "1.7e308"])
def test_a_record_with_huge_values(huge: str, here: Path) -> None:
    rows = [f"{k / 100},{np.cos(k / 100)},{np.sin(k / 100)}" for k in range(60)]
    rows[20], rows[30] = f"0.2,{huge},0", f"0.3,-{huge},0"
    (here / "log.csv").write_text("\n".join(["time,y,tau", *rows]))
    out, _ = hgogen("run", PENDULUM, "--data", "log.csv", "--time", "time", "--json")
    assert [one["ahead"] for one in json.loads(out)["predictions"]] == [1, 5, 25, None]
    assert json.loads((here / "build" / "pendulum" / "log_report.json").read_text()) == json.loads(out)


@pytest.mark.parametrize(
    ("value", "shown"),
    [(None, "never"), (0.0, "0"), (0.002, "0.002"), (0.0096, "0.0096"), (0.01, "0.01"), (9, "9.00")],
)
def test_a_short_time_is_told_in_full(value: float | None, shown: str) -> None:
    assert trial_runs.time_cell(value) == shown


# --- input --------------------------------------------------------------------------------------------------


def test_a_trial_that_asks_for_more_memory_than_there_is(here: Path) -> None:
    """At the door: nothing is written; and the duration that the sentence names is taken."""
    text = PENDULUM.read_text()
    (here / "long.py").write_text(
        text + "\nfrom dataclasses import replace\nshort = trial\ndef trial(): return replace(short(), duration=1e9)\n"
    )
    for command in ("build", "generate", "simulate"):
        _, err = hgogen(command, "long.py", status=2)
        assert "is 1e+12 samples of dt = 0.001 s, which take " in err
        assert " GiB of memory; take a duration of at most " in err
    assert [path.name for path in here.iterdir()] == ["long.py"]


@posix
@pytest.mark.parametrize(
    ("path", "said"),
    [
        ("pipe", "is a pipe, whose content may have no end; write it to a file"),
        ("socket", "is a socket"),
        ("/dev/zero", "is a device"),
        ("/dev/null", "is a device"),
        ("linked", "is a pipe"),
        (".", "is a folder; give a file in it"),
    ],
)
def test_what_is_no_regular_file_is_not_read(here: Path, path: str, said: str) -> None:
    """Nobody knows whether it ends. A pipe is refused with a writer and without."""
    os.mkfifo("pipe")
    os.symlink("pipe", "linked")
    with socket.socket(socket.AF_UNIX) as listening:
        listening.bind("socket")
        with pytest.raises(Unread, match=said):
            content_of(path, 100)
        held = os.open("pipe", os.O_RDWR)
        os.write(held, b"a,b\n1,2\n")
        with pytest.raises(Unread, match=said):
            content_of(path, 100)
        os.close(held)
    with pytest.raises(recheck.CannotRead, match="no regular file"):
        recheck.load(path)


@posix
@pytest.mark.parametrize(
    "command",
    [
        ("check", "{}.toml"),
        ("check", "{}.json"),
        ("check", "{}.py"),
        ("check", "--library", "{}.json"),
        ("recheck", "{}.json"),
        ("simulate", PENDULUM, "--parameters", "{}.json"),
        ("simulate", PENDULUM, "--tuning", "{}.json"),
        ("run", PENDULUM, "--data", "{}.csv", "--time", "t"),
        ("fit", PENDULUM, "--data", "{}.csv", "--time", "t"),
        ("tune", PENDULUM, "--data", "{}.csv", "--time", "t"),
    ],
)
def test_no_command_waits_for_a_pipe(here: Path, command: tuple[str, ...]) -> None:
    for suffix in ("toml", "json", "py", "csv"):
        os.mkfifo(f"pipe.{suffix}")
    _, err = hgogen(*(str(word).format("pipe") for word in command), status=2)
    assert "is a pipe" in err


def test_what_a_file_says_does_nothing_to_the_terminal(here: Path) -> None:
    """A name of a column that clears the screen, and one that reverses what is read, are written out."""
    Path("log.csv").write_text("a\u2066[2J,b\u202e\n1,2\n", encoding="utf-8")
    _, err = hgogen("run", PENDULUM, "--data", "log.csv", "--time", "t", status=2)
    assert r"one of a\u2066[2J, b\u202e" in err
    assert err.count("\n") == 1


@pytest.mark.full
@pytest.mark.parametrize("flow", ["1e308*10*x", "exp(exp(exp(exp(x))))"])
def test_a_flow_beyond_the_range_of_a_double_is_a_sentence(here: Path, flow: str) -> None:
    states, outputs = {"x": {"flow": flow, "low": -1, "high": 1}}, {"y": {"equation": "x"}}
    Path("steep.json").write_text(json.dumps({"name": "steep", "states": states, "outputs": outputs}))
    hgogen("check", "steep.json")


@pytest.mark.parametrize(
    ("tuning", "said"),
    [
        ({"a": 1}, "tuning.a"),
        ({"a": {"kind": "b"}}, "tuning.a"),
        ({"high_gain": {"theta": 1, "accept": 1}}, "accept"),
        ({"high_gain": {"theta": 1, "accept": [1]}}, "high_gain"),
    ],
)
def test_a_tuning_that_is_none_is_named(here: Path, tuning: Any, said: str) -> None:
    states, outputs = {"x": {"flow": "-x", "low": -1, "high": 1}}, {"y": {"equation": "x"}}
    Path("odd.json").write_text(json.dumps({"name": "odd", "states": states, "outputs": outputs, "tuning": tuning}))
    result = CliRunner().invoke(cli.app, ["check", "odd.json", "--all"])
    assert isinstance(result.exception, SystemExit | None)
    assert said in result.output


def test_what_is_read_is_limited(here: Path) -> None:
    Path("log").write_bytes(b"1" * 101)
    with pytest.raises(Unread, match="is larger than 100 bytes"):
        content_of("log", 100)
    assert content_of("log", 101) == b"1" * 101


def test_a_column_without_one_number(here: Path) -> None:
    (here / "log.csv").write_text("time,y,tau,note\n" + "".join(f"{k / 100},,{k},on\n" for k in range(50)))
    options = ("run", PENDULUM, "--data", "log.csv", "--time", "time")
    fix = "the column 'y' holds no number for y; say --map y=COLUMN, or take y out of the model to run without it"
    assert fix in " ".join(hgogen(*options, status=2)[1].split())
    said = hgogen(*options, "--map", "y=note", status=2)[1]
    assert "the column 'note' holds no number for y, but cells such as 'on'" in said


def test_two_models_of_one_name(here: Path) -> None:
    """Each would replace the files of the other."""
    for folder in ("a", "b"):
        (here / folder).mkdir()
    (here / "a" / "one.py").write_text(PENDULUM.read_text())
    (here / "b" / "ONE.py").write_text(PENDULUM.read_text())
    assert "have the same name" in " ".join(hgogen("generate", "a/one.py", "b/ONE.py", status=2)[1].split())
    assert not (here / "generated").exists()


@posix
def test_results_are_refused_where_a_folder_leads_elsewhere(here: Path) -> None:
    (here / "elsewhere").mkdir()
    (here / "out").mkdir()
    (here / "out" / "pendulum").symlink_to("../elsewhere")
    (here / "plain").write_text("kept")
    (here / "link").symlink_to("plain")
    os.mkfifo(here / "pipe")
    assert "is a link, where a folder belongs" in hgogen("generate", PENDULUM, "-o", "out", status=2)[1]
    for option in ("--certificate=link", "--json=link", "--certificate=pipe", "--json=pipe", "--certificate=/dev/null"):
        assert ", where a file belongs" in hgogen("check", PENDULUM, option, status=2)[1]
    assert not list((here / "elsewhere").iterdir())
    assert (here / "plain").read_text() == "kept"
    assert (here / "link").is_symlink()
    assert (here / "pipe").is_fifo()
