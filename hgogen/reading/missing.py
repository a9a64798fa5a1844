"""Samples of a log that are declared missing, by texts of the option --missing:

y=-999        those of one value
y=repeats     those that repeat the sample before
y=150..199    those from one number to another, both included
"""

import re
from collections.abc import Iterable, Sequence
from dataclasses import replace

import numpy as np

from hgogen.reading.cells import BadRecord
from hgogen.reading.log import of_signals
from hgogen.reading.measured import Record
from hgogen.signal import Signal

_ALIKE = 1e-9  # relative difference of equal values
_SAMPLES = re.compile(r"(\d+)\.\.(\d+)")


def without(record: Record, texts: Iterable[str], inputs: Sequence[Signal], outputs: Sequence[Signal]) -> Record:
    """Return the record with samples missing that `texts` "SIGNAL=WHAT" name. Raises: `BadRecord`."""
    values, notes, path = record.values.copy(), [], record.report.path
    for option, name, what in of_signals(path, "--missing", texts, inputs, outputs):
        column = values[:, record.names.index(name)]
        lost = _lost(column, what)
        if lost is None:
            reason = "must read SIGNAL=VALUE, SIGNAL=repeats or SIGNAL=FIRST..LAST, such as y=-999 or y=150..199"
            raise BadRecord(path, f"{option} {reason}")
        if not np.isfinite(column[~lost]).any():
            raise BadRecord(path, f"{option} leaves no sample of {name}; give another value, or fewer samples")
        notes.append(f"{name}: samples taken as missing by {what}: {int((lost & np.isfinite(column)).sum())}")
        column[lost] = np.nan
    return replace(record, values=values, report=replace(record.report, notes=(*record.report.notes, *notes)))


def _lost(column: np.ndarray, what: str) -> np.ndarray | None:
    """Return the mask (N,) of the samples that `what` means; None for no such text."""
    if match := _SAMPLES.fullmatch(what):
        first, last = map(int, match.groups())
        return (np.arange(len(column)) >= first) & (np.arange(len(column)) <= last)
    if what == "repeats":
        return np.append(False, column[1:] == column[:-1])
    try:
        return np.asarray(np.isclose(column, float(what), rtol=_ALIKE, atol=0.0))
    except ValueError:
        return None
