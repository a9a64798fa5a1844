"""The one rule for names in paths, at every door, and the one place that writes."""

import os
import socket
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

import hgogen as hg
from hgogen.model import MissingPart, load
from hgogen.reading.files import LONGEST, BadFileName, file_name_fault, name_key
from hgogen.reading.text_model import BadModelFile
from hgogen.target import CannotWrite
from hgogen.trial import BadTrial, Trial

GOOD = ("a", "six_jumps", "cold start", "Sprung 1", "Füllstand", "v1.2", "x" * LONGEST, "console", "com")
BAD = ("", ".", "..", "../x", "/x", "a/b", "a\\b", "c:x", "a\0b", "a\nb", "a\u202eb", "\udcff", ".x", "-o", " x", "x ")
BAD += ("x.", "CON", "nul", "aux.h", "Com1", "x" * (LONGEST + 1), "ü" * LONGEST, 'a"b', "a*", "a?", "<a>", "a|b")

PLANT = """name = "oscillator"
states.x1 = {unit = "V", low = -3, high = 3, flow = "x2"}
states.x2 = {unit = "V/s", low = -6, high = 6, flow = "mu*(1 - x1**2)*x2 - x1"}
parameters.mu = {value = 1.0}
outputs.y = {unit = "V", equation = "x1"}
"""


@pytest.mark.parametrize("name", GOOD)
def test_a_name_that_every_system_takes(name: str) -> None:
    assert file_name_fault(name) == ""


@pytest.mark.parametrize("name", BAD)
def test_a_name_that_is_refused_at_every_door(name: str) -> None:
    why = file_name_fault(name)
    assert why
    with pytest.raises(BadTrial, match="it becomes part of the names of files") as refused:
        Trial(name, 1, {})
    assert len(str(refused.value)) < 300


@pytest.mark.full
@given(st.text(max_size=120))
def test_what_is_allowed_is_one_part_of_a_path_as_it_stands(name: str) -> None:
    if file_name_fault(name):
        return
    assert Path(name).parts == (name,)
    assert os.path.normpath(os.path.join("a", name)) == os.path.join("a", name)
    assert len(os.fsencode(name)) <= LONGEST


def test_names_that_some_systems_take_for_one() -> None:
    assert name_key("Jump") == name_key("jUMP")
    assert name_key("é") == name_key("e\u0301")
    assert name_key("jump") != name_key("jumps")


@pytest.mark.parametrize("name", ["...toml", "..toml", "aux.toml", "-x.toml", ".hidden.toml", "a:b.toml"])
def test_the_name_of_a_models_file(name: str, tmp_path: Path) -> None:
    """ "...toml" has the stem "..", and its results lay above the folder that was named."""
    (tmp_path / name).write_text(PLANT)
    with pytest.raises(BadModelFile, match="in the name of the file"):
        load(tmp_path / name)


def test_the_names_of_a_plant_a_trial_and_a_tuning(tmp_path: Path) -> None:
    x, y = hg.Signal("x"), hg.Signal("y")
    for name in ("con", "x" * 101):
        with pytest.raises(BadFileName, match="it becomes part of the names of files"):
            hg.System(name, states=(x,), outputs=(y,), flow=[-x], output=[x])
    file = tmp_path / "m.toml"
    file.write_text(PLANT + 'trial = {name = "../../../evil", duration = 1}\n')
    with pytest.raises(BadModelFile, match=r"m.toml, trial: .*has '/' in it"):
        load(file).trials()
    for key in ("aux", "x" * 101):
        file.write_text(PLANT + f"[tuning.{key}]\nkind = 'high_gain'\ntheta = 5\npoles = [-1, -1]\ndt = 1e-3\n")
        with pytest.raises(BadModelFile, match="it becomes part of the names of files"):
            load(file).step(key)
    file.write_text(PLANT + "[tuning.quiet]\nkind = 'high_gain'\n[tuning.Quiet]\nkind = 'high_gain'\n")
    with pytest.raises(BadModelFile, match="is the same name on some systems"):
        load(file).step("quiet")


def test_trials_that_differ_in_case_only(tmp_path: Path) -> None:
    file = tmp_path / "m.py"
    file.write_text("from hgogen.trial import Trial\ndef trial(): return Trial('Jump', 1, {}), Trial('jump', 1, {})\n")
    with pytest.raises(MissingPart, match="two trials of one name"):
        load(file).trials()


# --- writing ----------------------------------------------------------------------------------------------------------


def everything(folder: Path) -> dict[str, object]:
    """What lies below a folder: kind, and content of regular files."""
    return {
        str(path.relative_to(folder)): (path.lstat().st_mode, path.read_bytes() if path.is_file() else None)
        for path in sorted(folder.rglob("*"))
        if not path.is_fifo()
    }


def test_what_is_written(tmp_path: Path) -> None:
    paths = hg.write({"a.txt": "é", "sub/b.bin": b"\0"}, tmp_path / "new" / "out")
    assert paths == [tmp_path / "new/out/a.txt", tmp_path / "new/out/sub/b.bin"]
    assert [path.read_bytes() for path in paths] == ["é".encode(), b"\0"]
    paths[0].chmod(0o600)
    hg.write({"a.txt": "again"}, tmp_path / "new" / "out")
    assert (paths[0].read_text(), paths[0].stat().st_mode & 0o777) == ("again", 0o600)
    assert len(everything(tmp_path)) == 5  # nothing temporary is left


@pytest.mark.parametrize(
    "name", ["", ".", "..", "../x", "a/../../x", "/nowhere/x", "a/../x", "a\0b", "\ud800", "x" * 300]
)
def test_a_name_that_leaves_the_folder(name: str, tmp_path: Path) -> None:
    with pytest.raises(CannotWrite):
        hg.write({"good": "1", name: "2"}, tmp_path / "out")
    assert not (tmp_path / "out").exists()  # not the good one either


def test_names_that_differ_in_case_only(tmp_path: Path) -> None:
    with pytest.raises(CannotWrite, match="are one name on some systems"):
        hg.write({"Jump.svg": "1", "jump.svg": "2"}, tmp_path)
    assert everything(tmp_path) == {}


def make(kind: str, path: Path) -> None:
    """Something at a path that is no regular file."""
    if kind == "folder":
        path.mkdir()
    elif kind == "pipe":
        os.mkfifo(path)
    elif kind == "socket":
        os.chdir(path.parent)  # its name may be short only
        with socket.socket(socket.AF_UNIX) as bound:
            bound.bind(path.name)
    elif kind == "device":
        try:
            os.mknod(path, 0o20666, os.makedev(1, 3))
        except OSError:
            pytest.skip("only root makes devices")
    else:
        path.symlink_to({"link": "target", "dangling link": "nowhere", "loop": path.name}[kind])


KINDS = ("folder", "pipe", "socket", "device", "link", "dangling link", "loop")


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="no such files here")
@pytest.mark.parametrize("kind", KINDS)
def test_what_is_no_regular_file_is_never_replaced(kind: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """In the place of a file, and, but for a folder, in that of a folder below the one that is named."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "target").write_text("kept")
    (tmp_path / "out").mkdir()
    make(kind, tmp_path / "out" / "name")
    before = everything(tmp_path)
    names = ["name"] if kind == "folder" else ["name", "name/file"]
    for name in names:
        with pytest.raises(CannotWrite, match="it is a"):
            hg.write({"good": "1", name: "2"}, tmp_path / "out")
    assert everything(tmp_path) == before
    if kind not in ("folder", "link"):
        with pytest.raises(CannotWrite):
            hg.write({"good": "1"}, tmp_path / "out" / "name")


def test_the_folder_that_is_named_may_be_a_link(tmp_path: Path) -> None:
    """Below it a link is refused, wherever it leads."""
    (tmp_path / "real" / "inner").mkdir(parents=True)
    (tmp_path / "named").symlink_to("real")
    hg.write({"a": "1"}, tmp_path / "named")
    assert (tmp_path / "real" / "a").read_text() == "1"
    (tmp_path / "real" / "sub").symlink_to("inner")
    with pytest.raises(CannotWrite, match="it is a link, where a folder belongs"):
        hg.write({"sub/a": "1"}, tmp_path / "named")
    assert not list((tmp_path / "real" / "inner").iterdir())


def test_a_disk_that_fills_up_leaves_what_was_there(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    hg.write({"a": "old", "b": "old"}, tmp_path)
    before, replace = everything(tmp_path), os.open

    def full(path: str, *rest: object, **options: object) -> int:
        if made and Path(path).name.startswith(".hgogen"):
            raise OSError(28, "No space left on device", str(path))
        made.append(path)
        return replace(path, *rest, **options)  # type: ignore[arg-type]

    made: list[str] = []
    monkeypatch.setattr(os, "open", full)
    with pytest.raises(CannotWrite, match=f"cannot write {tmp_path / 'b'}: No space left on device"):
        hg.write({"a": "new", "b": "new"}, tmp_path)
    assert everything(tmp_path) == before
