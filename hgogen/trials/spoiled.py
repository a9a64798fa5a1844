"""Where a run loses its estimate: a step without guards takes what is no number as it is, and it spoils the state."""

from collections.abc import Iterator

import numpy as np

from hgogen.calling.samples import Run
from hgogen.step import Step

Array = np.ndarray


def before_loss(run: Run) -> int:
    """How many samples there are before the first whose estimate is no number."""
    finite = np.isfinite(run.x).all(axis=1)
    return len(finite) if finite.all() else int(np.argmin(finite))


def loss(step: Step, run: Run, t: Array, u: Array, y: Array) -> Iterator[str]:
    """A sentence on the loss of an estimate over inputs u (N, m) and samples y (N, p) at times t (N,), if it is lost:
    since when, by what, and what to do."""
    first = before_loss(run)
    if first == len(t):
        return
    signals = np.array([s.name for s in (*step.inputs, *step.outputs)])
    absent = ~np.isfinite(np.hstack([u, y]))[: first + 1]
    rows = np.flatnonzero(absent.any(axis=1))
    since = f"from {t[first]:.6g} {step.time} on the estimate is no number, and no error counts"
    if step.guards == "all" or not len(rows):
        fix = "run it with --guards all, or lower" if step.guards == "none" else "lower"
        yield f"{since}: it grew beyond every number; {fix} the gains, or take a shorter --dt"
        return
    names = signals[absent[rows[-1]]]
    absent_at = f"{', '.join(names)} {'has' if len(names) == 1 else 'have'} no number at {t[rows[-1]]:.6g} {step.time}"
    fix = "run it with --guards all, or fill in what the log lacks"
    yield f"{absent_at}, which a step without guards cannot leave out: {since}; {fix}"
