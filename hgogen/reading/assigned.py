"""Texts of the command line that give a signal something: its column, SIGNAL=COLUMN, or a shift, SIGNAL=SAMPLES."""

from collections.abc import Iterable, Sequence

from hgogen.reading.log import BadRecord
from hgogen.signal import Signal


def signal_named(key: str, inputs: Sequence[Signal], outputs: Sequence[Signal]) -> str | None:
    """The signal that a text names: plain "u" and "y" are the only input and the only output."""
    names = [s.name for s in (*inputs, *outputs)]
    short = {"u": inputs, "y": outputs}
    if key not in names and len(short.get(key, ())) == 1:
        return str(short[key][0].name)
    return key if key in names else None


def shifts_of(path: str, texts: Iterable[str], inputs: Sequence[Signal], outputs: Sequence[Signal]) -> dict[str, int]:
    """Samples by signal, from texts "SIGNAL=SAMPLES", each of which may hold several, with commas between them.

    Raises: `BadRecord`.
    """
    shifts: dict[str, int] = {}
    for text in (part for each in texts for part in each.split(",")):
        key, _, number = (part.strip() for part in text.partition("="))
        name = signal_named(key, inputs, outputs)
        if name is None:
            listed = ", ".join(s.name for s in (*inputs, *outputs))
            raise BadRecord(path, f"--shift {text!r} names no signal; the signals are {listed}")
        if name in shifts:
            raise BadRecord(path, f"--shift gives {name} twice; leave one of them out")
        try:
            shifts[name] = int(number)
        except ValueError:
            reason = f"--shift {text!r} must read SIGNAL=SAMPLES, a whole number, such as u=1 for one sample later"
            raise BadRecord(path, reason) from None
    return shifts


def mapping(
    path: str, assignments: Iterable[str], inputs: Sequence[Signal], outputs: Sequence[Signal]
) -> dict[str, str]:
    """The column name of each signal, from texts "SIGNAL=COLUMN"; a signal that none names has a column of its own
    name.

    Plain "u" and "y" name the only input and the only output.

    Raises: `BadRecord`.
    """
    names = [s.name for s in (*inputs, *outputs)]
    columns = {name: name for name in names}
    seen: dict[str, str] = {}
    for text in assignments:
        key, equals, column = text.partition("=")
        key = signal_named(key.strip(), inputs, outputs) or key.strip()
        if not equals or not column.strip():
            raise BadRecord(path, f"--map {text!r} must read SIGNAL=COLUMN; the signals are {', '.join(names)}")
        if key not in names:
            raise BadRecord(path, f"--map {text!r} names no signal; the signals are {', '.join(names)}")
        if key in seen:
            raise BadRecord(path, f"--map {seen[key]!r} and --map {text!r} map {key} twice; leave one of them out")
        seen[key] = text
        columns[key] = column.strip()
    return columns
