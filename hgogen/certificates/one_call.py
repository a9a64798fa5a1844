"""One call of a step's program, walked in any arithmetic: statement by statement, in the order of every language.

What guards do beside is left out: every sample is there, that of the last call as well.
"""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from functools import lru_cache
from itertools import islice
from typing import Any, Protocol

from hgogen.graph import Graph
from hgogen.method import Method
from hgogen.part import Clock, Ode
from hgogen.program import Block, Place, Program, Repeat, Statement
from hgogen.rigor.computed import Real, Rounding, Unsure, exactly
from hgogen.rigor.lookup import Lookup, folded
from hgogen.step import Step

Columns = list[list[Any]]
_SAMPLES, _INPUTS = ("y_last", "y"), ("state", "work")  # at the last call, and at this one


class Arithmetic(Protocol):
    """What a walk asks of its values."""

    def held(self, number: float) -> Any:
        """A gain or a parameter of the program."""

    def constant(self, number: float) -> Any:
        """A number that stands in the program."""

    def apply(self, op: int, values: list[Any]) -> Any:
        """One operation, by CasADi's number of it. Raises: `Unsure`."""

    def call(self, function: Graph, columns: Columns, body: Callable[[Columns], Columns]) -> Columns:
        """The columns that a function of the program gives, by its `body`. Raises: `Unsure`."""


def after_call(
    arithmetic: Arithmetic,
    step: Step,
    fields: Sequence[Any],
    samples: Sequence[Sequence[Any]],
    inputs: Sequence[Sequence[Any]],
) -> list[Any]:
    """The elements of the observer's fields (N) after a call: of `fields` (N) before it, of the `samples` (2, p) and
    the `inputs` (2, m) of the last call and of this one. Raises: `Unsure`."""
    (part,) = step.observer.parts
    p = len(samples[0])
    if not isinstance(part, Ode) or step.clock.periods != (step.dt,) * p or step.observer.delays:
        raise Unsure("an observer that is more than one differential equation, or samples that are not of every call")
    clock = replace(step.clock, every=())
    rest = iter(fields)
    memory: dict[Place, list[Any]] = {Place("state", x.name): list(islice(rest, x.size)) for x in part.fields}
    memory |= {Place("work", name): list(y) for name, y in zip(_SAMPLES, samples, strict=True)}
    memory |= {Place(struct, "u"): list(u) for struct, u in zip(_INPUTS, inputs, strict=True)}
    memory[Place("work", "valid")] = [arithmetic.constant(1.0)] * p
    for struct, numbers in (("plant", step.layout.plant), ("gain", step.layout.gains)):
        memory |= {Place(struct, each.name): list(map(arithmetic.held, each.initial)) for each in numbers}
    for statement in _statements(step.method, part, clock):
        if not isinstance(statement, Block):
            raise Unsure("a loop or a matrix operation")
        arguments = [memory[place] for place, _ in statement.reads]
        memory |= zip(statement.writes, _outputs(arithmetic, statement.graph, arguments), strict=False)
    return [each for field in part.fields for each in memory[Place("state", field.name)]]


def rounding_errors(step: Step, real: Real, held: Sequence[Any], y: Sequence[Any], u: Sequence[Any]) -> list[Any]:
    """By element of the observer's fields (N), how far a call leaves it from what exact arithmetic makes of the same:
    of fields in the balls `held` (N), samples in `y` (p), now and at the last call, and inputs in `u` (m).

    What a step remembers, samples and inputs are numbers of the working precision, the same in both; gains, parameters,
    constants and what `tune` computes of them are rounded.

    Raises: `Unsure`.
    """
    fields, samples, inputs = (list(map(exactly, each)) for each in (held, y, u))
    return [each.error for each in after_call(Rounding(real), step, fields, [samples] * 2, [inputs] * 2)]


@lru_cache(maxsize=16)  # a program is walked on many pieces of the plant's ranges
def _statements(method: Method, part: Ode, clock: Clock) -> tuple[Statement, ...]:
    """Those of a call, one after the other."""
    pieces = method.ode(part, clock)
    return tuple(_plain((*pieces.tune, *pieces.predict)))


def _plain(program: Program | Iterable[Statement]) -> Iterable[Statement]:
    """The statements one after the other."""
    for statement in program:
        yield from _plain(statement.unrolled) if isinstance(statement, Repeat) else (statement,)


def _outputs(arithmetic: Arithmetic, graph: Graph, arguments: Sequence[Sequence[Any]]) -> Columns:
    """The outputs of an SX function. Raises: `Unsure`."""

    def call(function: Graph, values: Sequence[Any]) -> list[Any]:
        if isinstance(function, Lookup):
            raise Unsure("a table")
        rest = iter(values)
        columns = [list(islice(rest, function.nnz_in(k))) for k in range(function.n_in())]
        results = arithmetic.call(function, columns, lambda columns: _outputs(arithmetic, function, columns))
        return [value for column in results for value in column]

    return folded(graph, lambda k, i: arguments[k][i], arithmetic.constant, arithmetic.apply, call)
