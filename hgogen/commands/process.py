"""What the process of a command has: a standard output for results alone, and a Ctrl-C that is told from a model's own
KeyboardInterrupt."""

import io
import os
import signal
import sys
from collections.abc import Iterator
from contextlib import contextmanager, redirect_stdout
from contextvars import ContextVar
from typing import Any, TextIO

from rich.console import Console

WIDTH = 110  # of what is not a terminal, unless COLUMNS says otherwise
INTERRUPTED = 130  # the exit status after Ctrl-C, as a shell gives it: 128 + SIGINT
UNREAD = 141  # where the reader of the output is gone: 128 + SIGPIPE
_RESULTS: ContextVar[TextIO | None] = ContextVar("results", default=None)
_heard: list[int] = []
_unread: list[int] = []


class _Results(io.FileIO):
    """A standard output that remembers that its reader is gone."""

    def write(self, data: Any) -> int:
        try:
            return super().write(data)
        except BrokenPipeError:
            _unread.append(len(data))
            raise


def note(*sentences: str) -> None:
    """Say something on the standard error stream, each sentence in a line of its own."""
    for sentence in sentences:
        print(f"hgogen: {printable(sentence)}", file=sys.stderr)


def printable(text: str) -> str:
    """A text in which what a terminal obeys and does not show, as of a file of somebody else, is written out."""
    return "".join(c if c.isprintable() or c in "\n\t\xa0" else repr(c)[1:-1] for c in text)


def listen() -> None:
    """From now on Ctrl-C raises KeyboardInterrupt, in the process of a command; before, it ends it at once."""
    if signal.getsignal(signal.SIGINT) is signal.SIG_DFL:
        signal.signal(signal.SIGINT, _interrupt)


def _interrupt(number: int, frame: Any) -> None:
    _heard.append(number)
    raise KeyboardInterrupt


def interrupted() -> bool:
    """Whether there was a Ctrl-C."""
    return bool(_heard)


@contextmanager
def interruptible() -> Iterator[None]:
    """Within it, an error after a Ctrl-C is that Ctrl-C: of what a handler raises within its calls, CasADi makes errors
    of its own."""
    before = len(_heard)
    try:
        yield
    except Exception as error:
        if len(_heard) > before:
            raise KeyboardInterrupt from error
        raise


def set_apart() -> None:
    """Let descriptor 1 be another name of descriptor 2, and `sys.stdout` write to where descriptor 1 led."""
    if sys.stdout is None:  # it is closed, and no file is to take its number
        sys.stdout = io.TextIOWrapper(io.FileIO(os.open(os.devnull, os.O_WRONLY), "w"))
    try:
        ours = os.dup(1)
        os.dup2(os.open(os.devnull, os.O_WRONLY) if sys.stderr is None else 2, 1)
    except OSError:  # there is none, as under a service
        return
    raw = io.BufferedWriter(_Results(ours, "w"))
    sys.stdout = io.TextIOWrapper(raw, sys.stdout.encoding, "backslashreplace", line_buffering=raw.isatty())


def dropped() -> int:
    """Drop what is left to print, since nobody reads it; returns the exit status."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
    return UNREAD


def flushed(status: object) -> object:
    """The exit status after the last of the output."""
    if _unread:  # as of the help, which is printed, and ended, by typer
        return dropped()
    try:
        if sys.stdout is not None:
            sys.stdout.flush()
    except BrokenPipeError:
        return dropped()
    except OSError:  # as of a full disk, which was told where it was met
        dropped()
        return status or 2
    return status


def results() -> TextIO:
    """The stream of a command's results: what `sys.stdout` was when it began."""
    return _RESULTS.get() or sys.stdout


@contextmanager
def printing() -> Iterator[None]:
    """Within it, what is printed goes to the standard error stream, and `results` is where `sys.stdout` led."""
    token = _RESULTS.set(sys.stdout)
    try:
        with redirect_stdout(sys.stderr):
            yield
    finally:
        _RESULTS.reset(token)


class _Output(Console):
    def on_broken_pipe(self) -> None:
        """Leave it to the command."""
        raise BrokenPipeError


def console() -> Console:
    """For the results."""
    out = _Output(highlight=False, file=results())
    if not out.is_terminal and not os.environ.get("COLUMNS", "").isdigit():
        out.width = WIDTH
    return out
