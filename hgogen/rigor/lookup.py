"""A table as programs compute it: one operation, a bounded search for the cell and a polynomial of rounded numbers.

    k = how many breakpoints are <= x,    f(x) = c_k0 + d (c_k1 + d (c_k2 + d c_k3)),    d = x - s_k

of the cells of `hgogen.rigor.interpolation`, and of two arguments a search along each axis and, with e = y - s_l,

    f(x, y) = c_00 + e c_01 + d (c_10 + e c_11)        of the cell (k, l)

Beyond its points a table is held, and its slope 0. Where its argument keeps within them (`Axis.held`), what lies beyond
are estimates clamped to the ends and sums rounded past them: there a derivative stays what it is within, at the end.

Of what is not a number k is 0 and d is not a number, nor is the value: a lookup needs no guard. In a graph of CasADi it
is a call of its `graph`, whose name leads back to it.

CasADi differentiates through a call by the function's own derivative, and mistakes one that is zero by structure; so
`graph` depends on each of its arguments in any case. `jacobian` gives a graph whose slopes are lookups as well.
"""

import hashlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import cached_property, lru_cache, reduce
from itertools import accumulate, pairwise
from typing import Any

import casadi as ca
import numpy as np

from hgogen.rigor.interpolation import ZERO, Cells, Index, by_power, next_order, polynomial_value

Graph = Any
_KNOWN: dict[str, "Lookup"] = {}  # by the names of their functions: a call carries nothing else
_TERMS = 2  # of a polynomial in a graph, at least
_NAMES = (("x", "start", "k", "d"), ("y", "start_y", "j", "e"))


@dataclass(frozen=True)
class Argument:
    """One argument of a lookup: the names in emitted code of the argument, of its array, of the cell that is searched,
    and of the distance from its start; the breakpoint below each cell (n + 1)."""

    name: str
    array: str
    cell: str
    distance: str
    starts: tuple[float, ...]

    @property
    def breaks(self) -> tuple[float, ...]:
        """The breakpoints (n)."""
        return self.starts[1:]

    @property
    def probes(self) -> tuple[int, ...]:
        """The steps of the search, powers of two from the largest that is not above n."""
        return tuple(2**i for i in reversed(range(len(self.breaks).bit_length())))


@dataclass(frozen=True)
class Lookup:
    """A derivative of a table, of the `order` in each argument. `read`: the table as it is computed, held along each
    axis that it has no derivative by; along the others `cells` tells."""

    cells: Cells = field(compare=False)
    order: Index
    read: Cells = field(init=False)

    def __post_init__(self) -> None:
        ways = zip(self.cells.axes, self.order, strict=True)
        object.__setattr__(self, "read", self.cells.holding(*(axis.held or not k for axis, k in ways)))

    @property
    def name(self) -> str:
        """What it is called in emitted code: table_ocv, and its derivatives slope_ocv, slope_2_ocv, ..; of two
        arguments slope_1_0_friction, slope_0_1_friction, ..; those that are 0 beyond the points flat_slope_ocv,
        flat_x_slope_1_0_friction, .."""
        order = "" if self.order == (1,) else "".join(f"{k}_" for k in self.order)
        axes = "".join(f"{x}_" for x in self._flat) if len(self.order) > 1 else ""
        flat = f"flat_{axes}" if self._flat else ""
        return f"{flat}slope_{order}{self.cells.name}" if any(self.order) else f"table_{self.cells.name}"

    @property
    def said(self) -> str:
        """The comment above its function."""
        order = " and ".join(map(str, self.order))
        derivative = "slope" if self.order == (1,) else f"derivative of order {order}"
        of = f"the {derivative} of " if any(self.order) else ""
        points = " x ".join(str(len(axis.x)) for axis in self.cells.axes)
        kind = self.cells.kind if len(self.order) == 1 else "bilinear"
        ends = "held at its ends" if not any(self.order) or self._flat else "with its slopes held at its ends"
        return f"{of}the table {self.cells.name}: {kind}, {points} points, {ends}"

    @property
    def _flat(self) -> list[str]:
        """The arguments by which it is a derivative that is 0 beyond the points."""
        ways = zip(self.read.axes, self.order, _NAMES, strict=False)
        return [names[0] for axis, k, names in ways if k and axis.held]

    @cached_property
    def axes(self) -> tuple[Argument, ...]:
        """Its arguments."""
        starts = (tuple(map(float, axis.starts)) for axis in self.cells.axes)
        return tuple(Argument(*names, each) for names, each in zip(_NAMES, starts, strict=False))

    @cached_property
    def coefficients(self) -> np.ndarray:
        """The polynomial of the distances: an axis of powers for each argument, then for each one of cells."""
        pieces = self.read.of_order(self.order).copy()
        for k, axis in enumerate(self.read.axes):
            if not axis.held:  # beyond the points it stays what it is at the start of a cell
                along = np.moveaxis(pieces, (k, k + len(self.axes)), (0, 1))
                along[[0, -1], 1:] = ZERO
        return by_power(pieces).astype(float)

    @cached_property
    def arrays(self) -> dict[str, list[float]]:
        """Those of emitted code by their names: the starts of cells, and the coefficients, c with the powers of the
        distances."""
        starts = {axis.array: list(axis.starts) for axis in self.axes}
        powers = np.ndindex(self.coefficients.shape[: len(self.axes)])
        return starts | {f"c{''.join(map(str, each))}": self.coefficients[each].ravel().tolist() for each in powers}

    @property
    def flattened(self) -> list[str]:
        """The statements of emitted code by which the cell of the last axis becomes that of all of them."""
        return [f"{b.cell} = {a.cell} * {len(b.starts)} + {b.cell}" for a, b in pairwise(self.axes)]

    def formula(self, zero: str) -> str:
        """The polynomial as text, Horner's scheme in the order of `graph`; `zero` times a distance is what is not a
        number where the distance is none."""
        return _formula(self.coefficients.shape, "c", [axis.distance for axis in self.axes], self.axes[-1].cell, zero)

    def slopes(self, *arguments: Graph) -> Graph:
        """The row of its derivatives by each argument in a graph."""
        orders = (next_order(self.order, k) for k in range(len(arguments)))
        return ca.horzcat(*(Lookup(self.cells, order)(*arguments) for order in orders))

    def __call__(self, *arguments: Graph) -> Graph:
        """The value in a graph."""
        return self.graph(*arguments)

    @cached_property
    def graph(self) -> ca.Function:
        """The function in CasADi, which stays one operation of the graphs that call it."""
        text = repr((self.cells.name, self.cells.points, self.order, [axis.held for axis in self.cells.axes]))
        name = f"table_{hashlib.sha256(text.encode()).hexdigest()[:20]}"
        _KNOWN[name] = self
        names = [axis.name for axis in self.axes]
        arguments = [ca.MX.sym(each) for each in names]
        cells = [_cell(axis, x) for axis, x in zip(self.axes, arguments, strict=True)]
        d = [x - _element(axis.starts, k) for axis, x, k in zip(self.axes, arguments, cells, strict=True)]
        cell = reduce(lambda whole, part: whole * len(part[0].starts) + part[1], zip(self.axes, cells, strict=True), 0)
        missing = [(0, max(_TERMS - powers, 0)) for powers in self.coefficients.shape[: len(d)]]
        filled = np.pad(self.coefficients, [*missing, *[(0, 0)] * len(d)])
        result = polynomial_value(filled, d, lambda column: _element(column.ravel().tolist(), cell))
        return ca.Function(name, arguments, [result], names, ["value"], {"never_inline": True})


def _formula(shape: Sequence[int], name: str, distances: Sequence[str], cell: str, zero: str) -> str:
    """Horner's scheme for a polynomial of as many powers of each distance as the shape says."""
    if not distances:
        return f"{name}[{cell}]"
    d, *rest = distances
    parts = [_formula(shape[1:], f"{name}{power}", rest, cell, zero) for power in range(shape[0])]
    *others, total = parts if len(parts) > 1 else (*parts, zero)
    for part in reversed(others):
        total = f"{part} + {d} * ({total})"
    return total


def _cell(axis: Argument, x: Graph) -> Graph:
    n, k = len(axis.breaks), ca.MX(0)
    for probe in axis.probes:
        there = k + probe
        within = there <= n
        at = ca.if_else(within, there, 1) - 1
        k = k + probe * ca.logic_and(within, _element(axis.breaks, at) <= x)
    return k


def _element(numbers: Sequence[float], k: Graph) -> Graph:
    return ca.MX(ca.DM(list(numbers)))[k]


def called(instruction: Graph) -> Lookup | ca.Function:
    """The lookup that an instruction of a graph, a call, is of, or the other function that it calls."""
    function: ca.Function = instruction.which_function()
    return _KNOWN.get(function.name(), function)


Call = Callable[[ca.Function, Sequence[Graph]], Sequence[Graph]]


def walked(
    function: ca.Function,
    inputs: Sequence[Graph],
    apply: Callable[..., Graph],
    call: Call | None = None,
    operations: Sequence[int] = (),
) -> list[Graph]:
    """The outputs of an SX function at other inputs, by `apply(operation, lookup or None, arguments)`, and for a
    function that it calls by `call(function, its arguments)`; without one that is written out. `operations`: those of
    the instructions, CasADi's own without them."""

    def of_call(target: Lookup | ca.Function, elements: Sequence[Graph]) -> Sequence[Graph]:
        if isinstance(target, Lookup):
            return [apply(ca.OP_CALL, target, *elements)]
        ends = list(accumulate((target.numel_in(i) for i in range(target.n_in())), initial=0))
        columns = [ca.vertcat(*elements[a:b]) for a, b in pairwise(ends)]
        values = call(target, columns) if call else walked(target, columns, apply)
        return [each for value in values for each in value.nonzeros()]

    def of_operation(op: int, values: Sequence[Graph]) -> Graph:
        return apply(op, None, *values)

    outputs = folded(function, lambda k, i: inputs[k][i], ca.SX, of_operation, of_call, operations)
    results = [ca.SX(function.sparsity_out(k)) for k in range(function.n_out())]
    for result, elements in zip(results, outputs, strict=True):
        for k, element in enumerate(elements):
            result.nz[k] = element
    return results


def folded(
    function: ca.Function,
    inputs: Callable[[int, int], Any],
    constant: Callable[[float], Any],
    apply: Callable[[int, list[Any]], Any],
    call: Callable[[Any, list[Any]], Sequence[Any]],
    operations: Sequence[int] = (),
) -> list[list[Any]]:
    """The outputs of an SX function in any arithmetic, the nonzeros of each.

    `inputs(k, i)`: element i of argument k; `constant(number)`; `apply(operation, values)`; `call(function, values)`:
    what a lookup or a function gives, element by element. `operations`: as in `walked`.
    """
    work: dict[int, Any] = {}
    outputs = [[constant(0.0)] * function.nnz_out(k) for k in range(function.n_out())]
    rows = _rows(function)
    for (own, read, wrote, more), op in zip(rows, operations or (row[0] for row in rows), strict=True):
        if own == ca.OP_INPUT:
            work[wrote[0]] = inputs(*read)
        elif own == ca.OP_OUTPUT:
            outputs[wrote[0]][wrote[1]] = work[read[0]]
        elif own == ca.OP_CONST:
            work[wrote[0]] = constant(more)
        elif own == ca.OP_CALL:
            work |= zip(wrote, call(more, [work[place] for place in read]), strict=True)
        else:
            work[wrote[0]] = apply(op, [work[place] for place in read])
    return outputs


@lru_cache(maxsize=256)  # a program is walked on many pieces of a plant's ranges
def _rows(function: ca.Function) -> list[tuple[int, list[int], list[int], Any]]:
    """(operation, what it reads, what it writes, its number or what it calls) of each instruction."""
    rows, texts = [], instructions(function)
    for k in range(function.n_instructions()):
        op = function.instruction_id(k)
        number = function.instruction_constant(k) if op == ca.OP_CONST else None
        more = called(texts[k]) if op == ca.OP_CALL else number
        rows.append((op, list(function.instruction_input(k)), list(function.instruction_output(k)), more))
    return rows


def instructions(function: ca.Function) -> list[Graph]:
    """The instructions of an SX function as graphs, of which calls know what they call; none where it has no call."""
    return ca.vertsplit(function.instructions_sx()) if calls(function) else []


def calls(function: ca.Function) -> bool:
    """Whether an SX function calls another one."""
    return bool(function.find_functions(0))


def jacobian(rows: Graph, x: Graph) -> Graph:
    """The Jacobian of rows (p) in symbols x (n): that of CasADi, where slopes of tables are lookups.

    With a value c_i for each call f_i(a_i), in the order of the program,

        dr/dx = r_x + sum_i r_(c_i) D_i,    D_i = f_i'(a_i) (a_(i,x) + sum_(j < i) a_(i,c_j) D_j)

    where f_i' is the row of its derivatives by its arguments, and a_(i,x) has a row for each of them.
    """
    read = ca.symvar(rows)
    symbols = ca.vertcat(*read) if read else ca.SX(0, 1)
    program = ca.Function("rows", [symbols], [ca.densify(rows)])
    calls: list[tuple[Graph, Lookup, list[Graph]]] = []

    def apply(op: int, lookup: Lookup | None, *args: Graph) -> Graph:
        if lookup is None:
            return (ca.SX.unary if len(args) == 1 else ca.SX.binary)(op, *args)
        calls.append((ca.SX.sym(f"c{len(calls)}"), lookup, list(args)))
        return calls[-1][0]

    if not instructions(program):
        return ca.jacobian(rows, x)  # of which the bytes of emitted code are
    (whole,) = walked(program, [symbols], apply)
    stands, values, slopes = ca.SX(0, 1), ca.SX(0, 1), ca.SX(0, x.numel())
    for symbol, lookup, args in calls:
        at, row = ca.vertcat(*args), lookup.slopes(*args)
        slopes = ca.vertcat(slopes, row @ (ca.jacobian(at, x) + ca.jacobian(at, stands) @ slopes))
        values = ca.vertcat(values, lookup(*ca.vertsplit(ca.substitute(at, stands, values))))
        stands = ca.vertcat(stands, symbol)
    total = ca.jacobian(whole, x) + ca.jacobian(whole, stands) @ slopes
    return ca.substitute(total, stands, values)


def hessian(value: Graph, x: Graph) -> Graph:
    """The second derivatives of a value in symbols x (n, n), in which slopes of tables are lookups."""
    first = jacobian(value, x)
    program = ca.Function("rows", [ca.vertcat(*ca.symvar(value))] if ca.symvar(value) else [], [value])
    return jacobian(first.T, x) if instructions(program) else ca.hessian(value, x)[0]
