"""Ctrl-C while CasADi calls back, or computes."""

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any


@contextmanager
def heard() -> Iterator[list[Any]]:
    """The Ctrl-C within, which count when it ends: CasADi takes what a handler raises for a model that has no value."""
    heard: list[Any] = []
    before = signal.getsignal(signal.SIGINT)
    if not callable(before) or threading.current_thread() is not threading.main_thread():  # it is ignored, or not ours
        yield heard
        return
    signal.signal(signal.SIGINT, lambda *signalled: heard.append(signalled))
    try:
        yield heard
    finally:
        signal.signal(signal.SIGINT, before)
    if heard:
        before(*heard[-1])
