"""A table as programs compute it: one operation, a bounded search for the cell and a polynomial of rounded numbers.

    k = how many breakpoints are <= x,    f(x) = c_k0 + d (c_k1 + d (c_k2 + d c_k3)),    d = x - s_k

of the cells of `hgogen.algebra.cells`. Of what is not a number k is 0 and d is not a number, nor is the value: a lookup
needs no guard. In a graph of CasADi it is a call of its `graph`, whose name leads back to it.

CasADi differentiates through a call by the function's own derivative, and mistakes one that is zero by structure; so
`graph` has the terms up to d^3 in any case. `jacobian` gives a graph whose slopes are lookups as well.
"""

import hashlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import casadi as ca

from hgogen.algebra.cells import Cells

Graph = Any
_KNOWN: dict[str, "Lookup"] = {}  # by the names of their functions: a call carries nothing else
_TERMS = 4  # of a polynomial in a graph


@dataclass(frozen=True)
class Lookup:
    """A derivative of a table, of the order `order`, 0 for the table itself."""

    cells: Cells
    order: int = 0

    @property
    def name(self) -> str:
        """What it is called in emitted code: table_ocv, and its derivatives slope_ocv, slope_2_ocv, .."""
        return f"{('table', 'slope')[self.order > 0]}_{f'{self.order}_' * (self.order > 1)}{self.cells.name}"

    @property
    def said(self) -> str:
        """The comment above its function."""
        of = (
            ""
            if not self.order
            else "the slope of "
            if self.order == 1
            else f"the derivative of order {self.order} of "
        )
        return f"{of}the table {self.cells.name}: {self.cells.kind}, {len(self.cells.x)} points, held at its ends"

    @cached_property
    def breaks(self) -> tuple[float, ...]:
        """The breakpoints (n)."""
        return tuple(map(float, self.cells.x))

    @cached_property
    def starts(self) -> tuple[float, ...]:
        """The breakpoint below each cell (n + 1)."""
        return tuple(map(float, self.cells.starts))

    @cached_property
    def coefficients(self) -> tuple[tuple[float, ...], ...]:
        """Of each power of d, from 0, the number of each cell (n + 1)."""
        pieces = self.cells.of_order(self.order)
        count = max(map(len, pieces))
        return tuple(tuple(float(p[i]) if i < len(p) else 0.0 for p in pieces) for i in range(count))

    @property
    def slope(self) -> "Lookup":
        """The derivative."""
        return replace(self, order=self.order + 1)

    @property
    def probes(self) -> tuple[int, ...]:
        """The steps of the search, powers of two from the largest that is not above n."""
        return tuple(2**i for i in reversed(range(len(self.breaks).bit_length())))

    def __call__(self, x: Graph) -> Graph:
        """The value in a graph."""
        return self.graph(x)

    @cached_property
    def graph(self) -> ca.Function:
        """The function in CasADi, which stays one operation of the graphs that call it."""
        text = repr((self.cells.name, self.cells.kind, self.cells.x, self.cells.y, self.order))
        name = f"table_{hashlib.sha256(text.encode()).hexdigest()[:20]}"
        _KNOWN[name] = self
        x = ca.MX.sym("x")
        k = self._cell(x)
        d, terms = x - _element(self.starts, k), [_element(column, k) for column in self.coefficients]
        terms += [_element((0.0,) * len(self.starts), k)] * (_TERMS - len(terms))
        value = terms[-1]
        for c in terms[-2::-1]:
            value = c + d * value
        return ca.Function(name, [x], [value], ["x"], ["value"], {"never_inline": True})

    def _cell(self, x: Graph) -> Graph:
        n, k = len(self.breaks), ca.MX(0)
        for probe in self.probes:
            there = k + probe
            within = there <= n
            at = ca.if_else(within, there, 1) - 1
            k = k + probe * ca.logic_and(within, _element(self.breaks, at) <= x)
        return k


def _element(numbers: Sequence[float], k: Graph) -> Graph:
    return ca.MX(ca.DM(list(numbers)))[k]


def called(instruction: Graph) -> Lookup:
    """The lookup that an instruction of a graph, a call, is of. Raises: `KeyError` for another call."""
    return _KNOWN[instruction.which_function().name()]


def walked(function: ca.Function, inputs: Sequence[Graph], apply: Callable[..., Graph]) -> list[Graph]:
    """The outputs of an SX function at other inputs, by `apply(operation, lookup or None, arguments)`."""
    work: dict[int, Graph] = {}
    results = [ca.SX.zeros(*function.size_out(k)) for k in range(function.n_out())]
    texts = instructions(function)
    for k in range(function.n_instructions()):
        op, read, wrote = function.instruction_id(k), function.instruction_input(k), function.instruction_output(k)
        if op == ca.OP_INPUT:
            work[wrote[0]] = inputs[read[0]][read[1]]
        elif op == ca.OP_CONST:
            work[wrote[0]] = ca.SX(function.instruction_constant(k))
        elif op == ca.OP_OUTPUT:
            results[wrote[0]][wrote[1]] = work[read[0]]
        else:
            lookup = called(texts[k]) if op == ca.OP_CALL else None
            work[wrote[0]] = apply(op, lookup, *(work[place] for place in read))
    return results


def instructions(function: ca.Function) -> list[Graph]:
    """The instructions of an SX function as graphs, of which calls know what they call; none where it has no call."""
    calls = any(function.instruction_id(k) == ca.OP_CALL for k in range(function.n_instructions()))
    return ca.vertsplit(function.instructions_sx()) if calls else []


def jacobian(rows: Graph, x: Graph) -> Graph:
    """The Jacobian of rows (p) in symbols x (n): that of CasADi, where slopes of tables are lookups.

    With a value c_i for each call f_i(a_i), in the order of the program,

        dr/dx = r_x + sum_i r_(c_i) D_i,    D_i = f_i'(a_i) (a_(i,x) + sum_(j < i) a_(i,c_j) D_j)
    """
    symbols = ca.vertcat(*ca.symvar(rows)) if ca.symvar(rows) else ca.SX(0, 1)
    program = ca.Function("rows", [symbols], [ca.densify(rows)])
    calls: list[tuple[Graph, Lookup, Graph]] = []

    def apply(op: int, lookup: Lookup | None, *args: Graph) -> Graph:
        if lookup is None:
            return (ca.SX.unary if len(args) == 1 else ca.SX.binary)(op, *args)
        calls.append((ca.SX.sym(f"c{len(calls)}"), lookup, args[0]))
        return calls[-1][0]

    if not instructions(program):
        return ca.jacobian(rows, x)  # of which the bytes of emitted code are
    (whole,) = walked(program, [symbols], apply)
    stands, values, slopes = ca.SX(0, 1), ca.SX(0, 1), ca.SX(0, x.numel())
    for symbol, lookup, argument in calls:
        slope = lookup.slope(argument) * (ca.jacobian(argument, x) + ca.jacobian(argument, stands) @ slopes)
        slopes = ca.vertcat(slopes, slope)
        values = ca.vertcat(values, lookup(ca.substitute(argument, stands, values)))
        stands = ca.vertcat(stands, symbol)
    total = ca.jacobian(whole, x) + ca.jacobian(whole, stands) @ slopes
    return ca.substitute(total, stands, values)


def hessian(value: Graph, x: Graph) -> Graph:
    """The second derivatives of a value in symbols x (n, n), in which slopes of tables are lookups."""
    first = jacobian(value, x)
    program = ca.Function("rows", [ca.vertcat(*ca.symvar(value))] if ca.symvar(value) else [], [value])
    return jacobian(first.T, x) if instructions(program) else ca.hessian(value, x)[0]
