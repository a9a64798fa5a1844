"""What is the same for every test."""

import gc
import os

os.environ.pop("PYTHONDONTWRITEBYTECODE", None)  # each process that a test starts would compile the whole package


def pytest_collection_finish() -> None:
    """Graphs and expressions are many small objects, most of them alive to the end: a collection for every 700 new
    ones takes a twelfth of the run, and what is imported by now is never garbage."""
    gc.freeze()
    gc.set_threshold(20_000, 20, 20)
