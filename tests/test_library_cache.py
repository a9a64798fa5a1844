"""Compiled libraries in their folder: only what this user built for a program is loaded; compilers that misbehave."""

import os
import shutil
import stat
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import pytest

from hgogen.run import native
from hgogen.run.native import cache_folder, is_kept, keep
from hgogen.target import write

pytestmark = pytest.mark.skipif(os.name != "posix", reason="the files of other systems have no owner and no mode")
needs_compiler = pytest.mark.skipif(native.compiler() is None, reason="no C compiler")


def returning(number: int) -> dict[str, str]:
    """The files of a library, another one for each number."""
    return {"f.c": f"int f(void);\nint f(void) {{ return {number}; }}\n"}


ONE, TWO = returning(1), returning(2)


@pytest.fixture
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    return tmp_path / "cache" / "hgogen"


def loaded(number: int) -> int:
    """What a library returns in a process that has not loaded it before."""
    code = f"from hgogen.run import native\nprint(native.library({returning(number)!r}).f())"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    return int(done.stdout)


def truncated(path: Path) -> None:
    path.write_bytes(path.read_bytes()[:4096])


def of_another_program(path: Path) -> None:
    """With a digest beside it that is right for the content under its own name."""
    other = path.with_name("0" * 32 + ".so")
    content = path.read_bytes()
    keep(other, content + b"another")
    for each in (".so", ".sha256"):
        shutil.move(other.with_suffix(each), path.with_suffix(each))


def without_digest(path: Path) -> None:
    path.with_suffix(".sha256").unlink()


def writable(path: Path) -> None:
    path.chmod(0o666)


def digest_writable(path: Path) -> None:
    path.with_suffix(".sha256").chmod(0o620)


@pytest.mark.parametrize("spoil", [truncated, of_another_program, without_digest, writable, digest_writable])
def test_a_library_that_is_not_as_it_was_written_is_not_loaded(cache: Path, spoil: Callable[[Path], None]) -> None:
    with cache_folder() as folder:
        path = cache / "k.so"
        keep(folder / "k.so", b"content" * 1000)
        assert is_kept(folder / "k.so")
        assert path.stat().st_mode & 0o777 == 0o600
        spoil(path)
        assert not is_kept(folder / "k.so")
        keep(folder / "k.so", b"content")
        assert is_kept(folder / "k.so")


def test_neither_is_a_link_nor_a_pipe(cache: Path) -> None:
    with cache_folder() as folder:
        keep(folder / "k.so", b"content")
        (cache / "k.so").rename(cache / "other")
        (cache / "k.so").symlink_to("other")
        assert not is_kept(folder / "k.so")
        (cache / "k.so").unlink()
        os.mkfifo(cache / "k.so")
        assert not is_kept(folder / "k.so")


def test_neither_is_one_of_another_user(cache: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with cache_folder() as folder:
        keep(folder / "k.so", b"content")
        other = os.geteuid() + 1
        monkeypatch.setattr(os, "geteuid", lambda: other)
        assert not is_kept(folder / "k.so")
    with cache_folder() as folder:
        assert folder == native.process_folder()


def test_the_folder_is_closed_to_others(cache: Path) -> None:
    cache.mkdir(parents=True)
    cache.chmod(0o777)
    with cache_folder() as folder:
        assert folder.samefile(cache)
    assert stat.S_IMODE(cache.stat().st_mode) == 0o700


@pytest.mark.skipif(not Path("/proc/self/fd").is_dir(), reason="the system does not show what is open")
def test_exchanging_the_folder_exchanges_nothing(cache: Path) -> None:
    """What is verified in the open folder is what is loaded from it, whatever the name leads to meanwhile."""
    with cache_folder() as folder:
        keep(folder / "k.so", b"content")
        cache.rename(cache.with_name("moved"))
        cache.mkdir()
        (cache / "k.so").write_bytes(b"forged")
        assert is_kept(folder / "k.so")
        assert (folder / "k.so").read_bytes() == b"content"


def test_a_folder_of_the_working_folder_is_no_cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("XDG_CACHE_HOME", "here")
    monkeypatch.setenv("HOME", str(tmp_path / "home"))
    with cache_folder() as folder:
        assert folder.samefile(tmp_path / "home" / ".cache" / "hgogen")
    assert not (tmp_path / "here").exists()


@pytest.mark.full
@needs_compiler
def test_what_is_spoiled_is_built_anew_and_what_is_not_is_not(cache: Path) -> None:
    """A truncated library would end the process that loads it, and another program's would answer for this one."""
    assert native.library(returning(11)).f() == 11
    (first,) = cache.glob("*.so")
    assert native.library(returning(12)).f() == 12
    (second,) = (path for path in cache.glob("*.so") if path != first)
    whole, untouched = first.read_bytes(), second.stat()
    for spoiled in (whole[:4096], second.read_bytes()):
        write({first.name: spoiled}, cache)
        assert loaded(11) == 11
        assert len(first.read_bytes()) == len(whole)
    assert loaded(12) == 12
    assert second.stat().st_ino == untouched.st_ino


@needs_compiler
def test_where_it_cannot_be_kept_it_is_loaded_all_the_same(cache: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    asked = list[Path]()

    def full(path: Path, content: bytes) -> None:
        asked.append(path.parent)
        if path.parent != native.process_folder():
            raise native.CannotWrite(str(path), "No space left on device")
        keep(path, content)

    monkeypatch.setattr(native, "keep", full)
    assert native.library(returning(13)).f() == 13
    assert asked[1:] == [native.process_folder()]
    assert not list(cache.iterdir())


# --- what a killed process left -------------------------------------------------------------------------------------


@pytest.mark.full
def test_what_a_killed_process_left_is_removed(cache: Path) -> None:
    code = (
        "import os, signal, hgogen.target as target\n"
        "target.os.replace = lambda *_: os.kill(os.getpid(), signal.SIGKILL)\n"
        f"target.write({{'a': 'A', 'deep/b': 'B'}}, {str(cache)!r})\n"
    )
    done = subprocess.run([sys.executable, "-c", code], check=False)
    assert done.returncode == -9
    assert len([*cache.rglob(".hgogen-*")]) == 2
    write({"deep/b": "new"}, cache)
    assert [path.name for path in cache.rglob("*") if path.is_file()] == ["b"]


def test_what_another_process_writes_stays(cache: Path) -> None:
    code = (
        "import sys, hgogen.target as target\n"
        "replace = target.os.replace\n"
        "target.os.replace = lambda *names: (print('staged', flush=True), sys.stdin.readline(), replace(*names))\n"
        f"target.write({{'a': 'A'}}, {str(cache)!r})\n"
    )
    command = [sys.executable, "-c", code]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as other:
        assert other.stdout
        assert other.stdin
        assert other.stdout.readline() == "staged\n"
        write({"b": "B"}, cache)
        other.stdin.write("\n")
        other.stdin.close()
        assert other.wait() == 0
    assert {path.name: path.read_text() for path in cache.iterdir()} == {"a": "A", "b": "B"}


# --- compilers ------------------------------------------------------------------------------------------------------


@pytest.fixture
def scripted(tmp_path: Path, cache: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[[str], Path]:
    """Makes a script the C compiler."""

    def script(text: str) -> Path:
        path = tmp_path / "own tools" / "cc"
        path.parent.mkdir(exist_ok=True)
        path.write_text(text)
        path.chmod(0o755)
        monkeypatch.setenv("CC", str(path))
        return path

    return script


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("#!/bin/sh\nexit 0\n", "it ended with status 0, but wrote no step.so"),
        ("#!/bin/sh\nexit 3\n", "the compiler failed"),
        ("#!/bin/sh\nprintf '\\377\\376' >&2; exit 3\n", "\ufffd\ufffd"),
        ("no program\0", "it cannot be started: Exec format error"),
        ("#!/bin/sh\n[ $1 = -E ] || echo no library > step.so\n", "what it made cannot be loaded"),
        ("#!/bin/sh\n[ $1 = -E ] || mkdir step.so\n", "wrote no step.so"),
    ],
)
def test_a_compiler_that_fails_is_a_sentence(
    scripted: Callable[[str], Path], cache: Path, text: str, said: str
) -> None:
    """Nothing of it is kept for when it is mended."""
    path = scripted(text)
    for files in (ONE, TWO):
        with pytest.raises(native.CompilerFailed) as raised:
            native.library(files)
        assert said in str(raised.value)
        assert f"the compiler failed: {path}" in str(raised.value)
        assert "name another by $CC" in str(raised.value)
    assert not list(cache.glob("*.so"))


def test_a_compiler_that_hangs_is_ended_with_what_it_started(
    scripted: Callable[[str], Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    scripted(f"#!/bin/sh\nsleep 600 & echo $! > {tmp_path}/child\nwait\n")
    monkeypatch.setattr(native, "SOON", 1.0)
    with pytest.raises(native.CompilerFailed, match="it did not end within 1 s"):
        native.library(ONE)
    child = int((tmp_path / "child").read_text())
    end = time.monotonic() + 60
    while _runs(child):
        assert time.monotonic() < end
        time.sleep(0.01)


def _runs(child: int) -> bool:
    """Whether a process is there and no zombie, as it may be where nobody asks for its end."""
    state = Path(f"/proc/{child}/stat")
    if Path("/proc/self/stat").exists():
        try:
            return state.read_text().rpartition(")")[2].split()[0] != "Z"
        except (FileNotFoundError, ProcessLookupError):
            return False
    try:
        os.kill(child, 0)
    except ProcessLookupError:
        return False
    return True


@needs_compiler
@pytest.mark.parametrize("form", ["{path}", "'{path}' -DUNUSED", "env FOO=1 {cc}"])
def test_a_compiler_may_have_blanks_in_its_path_and_arguments(
    scripted: Callable[[str], Path], monkeypatch: pytest.MonkeyPatch, form: str, tmp_path: Path
) -> None:
    monkeypatch.delenv("CC", raising=False)
    cc = native.compiler()
    path = scripted(f'#!/bin/sh\necho "$@" >> {tmp_path}/asked\nexec {cc} "$@"\n')
    monkeypatch.setenv("CC", form.format(path=path, cc=cc))
    assert native.library(returning(len(form))).f() == len(form)
    assert (tmp_path / "asked").exists() is ("path" in form)
    if "UNUSED" in form:
        assert "-DUNUSED -std=c99" in (tmp_path / "asked").read_text()


@needs_compiler
def test_a_compilers_name_may_be_no_text(tmp_path: Path, cache: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("CC", raising=False)
    path = os.fsdecode(os.fsencode(tmp_path) + b"/cc\xff")
    os.symlink(native.compiler() or "", path)
    monkeypatch.setenv("CC", path)
    assert native.library(returning(5)).f() == 5
