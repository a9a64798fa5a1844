"""Linear algebra on one thread: threads of BLAS wait for each other longer than a matrix of tens of rows takes, and
what they add up depends on how many they are."""

from contextlib import AbstractContextManager
from functools import cache
from typing import Any

from threadpoolctl import ThreadpoolController


def one_thread() -> AbstractContextManager[Any]:
    """Within it NumPy's linear algebra takes one thread."""
    limit: AbstractContextManager[Any] = _threads().limit(limits=1, user_api="blas")
    return limit


_threads = cache(ThreadpoolController)  # of the process, looked for once, as that takes ten milliseconds
