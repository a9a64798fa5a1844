"""A part of a graph that emitted code keeps as a function of its own: the plant's flow, which each stage of a
Runge-Kutta step calls, its Jacobian, or the right-hand side of a whole observer.

In a graph it is a call of a CasADi function that is never inlined. What it reads of the step's memory, such as
parameters, it is given as further arguments; the names of their symbols say which places these are.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property

import casadi as ca

from hgogen.graph import Graph
from hgogen.program import Place, address, column, sym

RATE = "rate"  # the name of the last of these
MEANINGS = {
    "flow": "the plant's equation x' = f(x, u), in the coordinates of the estimate, but for rows that are constant",
    "jacobian": "the entries of the flow's Jacobian that are not constant, by columns",
    RATE: "the right-hand side of the observer's differential equation",
}
Values = Mapping[str, Graph]


@dataclass(frozen=True)
class Argument:
    """A column that a routine is given; `place`: where it lies, if the routine reads it from the step's memory."""

    name: str
    size: int
    place: Place | None = None

    @property
    def label(self) -> str:
        """What it is called in emitted code."""
        return self.place.name if self.place else self.name

    def local(self, element: int) -> str:
        """What an element is called: z1, or of a column of one that column's name."""
        return self.label if self.size == 1 else f"{self.label}{element + 1}"


@dataclass(frozen=True, eq=False)
class Routine:
    """A routine as a call of it shows it: the CasADi function that is called."""

    function: ca.Function

    @property
    def name(self) -> str:
        """What it is called in emitted code, without the prefix: a key of `MEANINGS`."""
        return str(self.function.name())

    @cached_property
    def key(self) -> str:
        """The same for two routines that compute the same of the same arguments."""
        return str(self.function.serialize())

    @cached_property
    def arguments(self) -> tuple[Argument, ...]:
        """What it is given, in order."""
        arguments = []
        for name, symbols in zip(self.function.name_in(), self.function.sx_in(), strict=True):
            place = address(symbols[0])[0] if _lies(symbols[0]) else None
            arguments.append(Argument(name, symbols.numel(), place))
        return tuple(arguments)

    def elements(self, argument: int) -> tuple[int, ...]:
        """The elements that it reads of an argument."""
        steps = range(self.function.n_instructions())
        reads = (self.function.instruction_input(k) for k in steps if self.function.instruction_id(k) == ca.OP_INPUT)
        return tuple(sorted({element for number, element in reads if number == argument}))

    @cached_property
    def results(self) -> tuple[tuple[str, int], ...]:
        """The names and sizes of what it computes, of a matrix how many elements."""
        return tuple((name, self.function.nnz_out(k)) for k, name in enumerate(self.function.name_out()))

    def entries(self, result: int) -> list[str]:
        """What the elements of a result are called: of a matrix F_21, by columns; of a column that leaves some out dz3;
        "" where the place in it says so."""
        pattern, name = self.function.sparsity_out(result), self.function.name_out(result)
        if pattern.is_column():
            return ["" if row == k else f"{name}{row + 1}" for k, row in enumerate(pattern.row())]
        between = "_" if max(pattern.shape) > 9 else ""
        return [f"{name}_{i + 1}{between}{j + 1}" for i, j in zip(*pattern.get_triplet(), strict=True)]


def _lies(symbol: Graph) -> bool:
    """Whether a symbol stands for a place, whose address is its name."""
    return ":" in symbol.name()


def routine(
    name: str, sizes: Mapping[str, int], body: Callable[[Values], Values]
) -> Callable[[Values], dict[str, Graph]]:
    """A routine to call on columns by the names of `sizes`, which gives what `body` does, by the same names.

    An argument that `body` does not read is none of the routine's. What is a number stays one: the routine computes the
    other elements, and no result that is all numbers.
    """
    arguments = {key: column(ca.SX.sym(f"{key}_{k}") for k in range(size)) for key, size in sizes.items()}
    results = {key: _Result(value) for key, value in body(arguments).items()}
    moving = {key: result for key, result in results.items() if not result.value.is_constant()}
    if not moving:
        return lambda _: {key: result.value for key, result in results.items()}
    values = ca.cse([result.computed for result in moving.values()])
    symbols = ca.symvar(ca.veccat(*values))
    names = {symbol.name() for symbol in symbols}
    read = [key for key, each in arguments.items() if any(symbol.name() in names for symbol in ca.vertsplit(each))]
    places = sorted({(place, size) for place, _, size in map(address, filter(_lies, symbols))})
    columns = [*(arguments[key] for key in read), *(sym(*place, size) for place, size in places)]
    labels = [*read, *(f"place{k}" for k in range(len(places)))]
    function = ca.Function(name, columns, values, labels, [*moving], {"never_inline": True})

    def call(at: Values) -> dict[str, Graph]:
        computed = function.call([*(ca.SX(at[key]) for key in read), *columns[len(read) :]])
        filled = {key: moving[key].filled(new) for key, new in zip(moving, computed, strict=True)}
        return {key: filled.get(key, result.value) for key, result in results.items()}

    return call


@dataclass(frozen=True)
class _Result:
    """What a routine's body gives, of which the routine computes what is no number."""

    value: Graph

    @cached_property
    def _computed(self) -> list[int]:
        """The nonzeros that the routine computes."""
        return [k for k, each in enumerate(self.value.nonzeros()) if not each.is_constant()]

    @property
    def computed(self) -> Graph:
        """What the routine computes, sparse."""
        rows, columns = self.value.sparsity().get_triplet()
        places = ([each[k] for k in self._computed] for each in (rows, columns))
        elements = self.value.nonzeros()
        return ca.SX(ca.Sparsity.triplet(*self.value.shape, *places), column(elements[k] for k in self._computed))

    def filled(self, computed: Graph) -> Graph:
        """The same with what the routine has computed; numbers stay numbers."""
        elements = self.value.nonzeros()
        for k, each in zip(self._computed, computed.nonzeros(), strict=True):
            elements[k] = each
        return ca.SX(self.value.sparsity(), column(elements))
