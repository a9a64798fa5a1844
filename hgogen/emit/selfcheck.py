"""The self-check of emitted code in every language: recorded samples, what must come of them, and the names of both."""

from collections.abc import Iterable, Sequence
from dataclasses import replace

from hgogen.emit.code import indented
from hgogen.emit.statements import Writer
from hgogen.emit.syntax import Real, Syntax
from hgogen.emit.vectors import faults, lost, places, record, start
from hgogen.program import Place
from hgogen.step import Step


def caller(syntax: Syntax, step: Step, real: Real) -> Writer:
    """Writes what a caller does whose structs are named as the parameters are."""
    return Writer(replace(syntax, reach="{}."), step, real)


def recorded(here: Writer, row: str, across: int) -> dict[str, str]:
    """What a template of a self-check has places for; to compute it takes a while.

    Args: `here`, that of the caller; `row`: {}, a row of a table of numbers; `across`: so many statuses are in a line.
    """
    step, syntax, real = here.step, here.syntax, here.real
    vectors, seen = record(step, real), [here.whole(place) for place in places(step)]
    signals = [here.whole(place) for place, _ in _signals(step)]
    statuses = [f"{syntax.literal(value, 'unsigned')}," for value in vectors.status]
    starting = (
        f"{here.lvalue(place, i, len(values))} = {syntax.literal(value, real)};"
        for place, values in start(step).items()
        for i, value in enumerate(values)
    )

    def rows(table: Iterable[Sequence[float]]) -> str:
        numbers = ([syntax.literal(float(v) if v == v else 0.0, real) for v in each] for each in table)
        return block(row.format(", ".join(each)) for each in numbers)

    return {
        "name": step.name,
        "real": syntax.types[real],
        "count": str(len(vectors.status)),
        "faults": faults(step),
        "width": str(len(signals)),
        "signals": ", ".join(signals),
        "given": rows([*u, *y] for u, y in zip(vectors.u, vectors.y, strict=True)),
        "results": str(len(seen)),
        "seen": ", ".join(seen),
        "wanted": rows(vectors.seen),
        "tolerance": ", ".join(syntax.literal(float(value), real) for value in vectors.tolerance),
        "expected": block(" ".join(statuses[k : k + across]) for k in range(0, len(statuses), across)),
        "start": block(starting),
    }


def filled(here: Writer, text: str) -> list[str]:
    """What gives a call its signals, first the inputs.

    `text`: {place}, {name}, {column}, {missing}, how one is given the number in a column of the table, and at the
    sample `missing` what is no number.
    """
    return [
        text.format(place=here.whole(place), name=here.syntax.name(place.name), column=column, missing=missing)
        for column, (place, missing) in enumerate(_signals(here.step))
    ]


def block(lines: Iterable[str], by: int = 4) -> str:
    """Lines as one text, so many blanks to the right."""
    return "\n".join(indented(lines, by))


def _signals(step: Step) -> list[tuple[Place, int]]:
    """The places of the signals that a call is given, and the sample at which each is no number."""
    no_input, no_output = lost(step)
    inputs = [(Place("input", signal.name), no_input) for signal in step.inputs]
    return inputs + [(Place("output", signal.name), no_output) for signal in step.samples]
