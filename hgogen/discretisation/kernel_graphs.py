"""Matrix operations as CasADi functions, in the order of operations of `kernels`; and counts of a program's operations.

In such a function, a loop that the kernel may leave early runs to its bound, without effect from the exit on.
`executed_operations` counts the operations of a sample period, `text_operations` those in the text of a program: hgogen
chooses between two programs by both, and `emit.cost` reports the first. An operation is one of the program's
instructions: an addition, a product, a comparison, a choice, a function.
"""

import ast
import inspect
import math
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import cache, lru_cache, reduce
from types import CodeType, FunctionType, SimpleNamespace
from typing import Any

import casadi as ca
import numpy as np

from hgogen.discretisation import notation
from hgogen.discretisation.kernels import KERNELS
from hgogen.discretisation.notation import DEGREE, HALVINGS, SWEEPS
from hgogen.graph import Graph
from hgogen.program import Block, Call, Copy, Kernel, Loop, Reader, Statement, When, blocks, walk
from hgogen.rigor.lookup import called, instructions


@cache
def kernel_graph(name: str, n: int, sizes: tuple[int, ...], counts: tuple[int, ...] = ()) -> ca.Function:
    """Return the kernel `name` with its constants `counts` as a CasADi function from its arguments, of these sizes, to
    their new values and its result. A kernel on the columns of a matrix has an (n, n) matrix as its first argument."""
    if name in _ON_MATRICES:
        arguments = [ca.MX.sym(f"a{k}", size) for k, size in enumerate(sizes)]
        return ca.Function(name, arguments, [*_ON_MATRICES[name](*arguments), ca.MX(0)])
    symbols = [ca.SX.sym(f"a{k}", *shape) for k, shape in enumerate([(n, n), *((size, 1) for size in sizes)])]
    matrix, *vectors = symbols
    others = [*map(ca.vertsplit, vectors)]
    L = [SimpleNamespace(v=ca.vertsplit(column)) for column in ca.horzsplit(matrix)]
    kinds = [*KERNELS[name].__annotations__.values()][1:]
    values = [each[0] if kind is float else each for each, kind in zip(others, kinds, strict=False)]
    result = FunctionType(_with_choices(name), {**notation.sizes(n), **_WORDS})(L, *values, *counts)
    after = [ca.horzcat(*(ca.vertcat(*column.v) for column in L)), *(ca.vertcat(*each) for each in others)]
    return ca.Function(name, symbols, [*after, ca.SX(0) if result is None else result])


# --- on L D L': the kernel itself, on scalars


@cache
def _with_choices(name: str) -> CodeType:
    """Return the code of a kernel in which a branch on numbers computes both of its ways and chooses one."""
    (function,) = ast.parse(inspect.getsource(KERNELS[name])).body
    assert isinstance(function, ast.FunctionDef)
    function.decorator_list = []
    module = ast.Module([_Choices().visit(function)], [])
    code = compile(ast.fix_missing_locations(module), f"<{name} with choices>", "exec")
    return next(each for each in code.co_consts if isinstance(each, CodeType))


class _Choices(ast.NodeTransformer):
    """A transformer of a kernel's syntax: `choice`, `both` and `opposite` in place of if, and, not. A name that a
    branch assigns is used in it alone; an element that it assigns keeps its value where the branch is not taken."""

    test: ast.expr | None = None

    def visit_IfExp(self, node: ast.IfExp) -> ast.expr:
        return _call("choice", *map(self.visit, (node.test, node.body, node.orelse)))

    def visit_BoolOp(self, node: ast.BoolOp) -> ast.expr:
        if not isinstance(node.op, ast.And):
            raise NotImplementedError(ast.unparse(node))
        return _call("both", *map(self.visit, node.values))

    def visit_UnaryOp(self, node: ast.UnaryOp) -> ast.expr:
        return _call("opposite", self.visit(node.operand)) if isinstance(node.op, ast.Not) else node

    def visit_If(self, node: ast.If) -> ast.If:
        if self.test or node.orelse:
            raise NotImplementedError(ast.unparse(node))
        self.test = self.visit(node.test)
        body = [self.visit(statement) for statement in node.body]
        node, self.test = ast.If(_call("possible", self.test), body, []), None
        return node

    def visit_Assign(self, node: ast.Assign) -> ast.Assign:
        (target,), value = node.targets, self.visit(node.value)
        if self.test and isinstance(target, ast.Subscript):
            value = _call("choice", self.test, value, ast.Subscript(target.value, target.slice, ast.Load()))
        return ast.Assign([target], value)


def _call(name: str, *arguments: ast.expr) -> ast.expr:
    return ast.Call(ast.Name(name, ast.Load()), list(arguments), [])


def _choice(test: Graph, yes: Graph, no: Graph) -> Graph:
    return (yes if test else no) if isinstance(test, bool) else ca.if_else(test, yes, no)


_WORDS: Mapping[str, Callable[..., Any]] = {
    "aligned": notation.aligned,
    "array": notation.array,
    "choice": _choice,
    "both": ca.logic_and,
    "opposite": ca.logic_not,
    "possible": lambda test: test is not False,
}


# --- on a matrix by rows, in one array


def _rows(x: Graph) -> Graph:
    n = int(np.sqrt(x.numel()))
    return ca.reshape(x, n, n).T


def _flat(matrix: Graph) -> Graph:
    return ca.vec(matrix.T)


def _size(values: Graph, but: int) -> Graph:
    return reduce(lambda total, j: total + ca.fabs(values[j]), (j for j in range(values.numel()) if j != but), ca.MX(0))


@cache
def _doubled(up: bool) -> Graph:
    x = ca.SX.sym("x", 4)
    f, column, row, active = ca.vertsplit(x)
    if up:
        again, then = ca.logic_not(column >= row / 2), (f * 2, column * 2, row / 2)
    else:
        again, then = ca.logic_not(column < row * 2), (f / 2, column / 2, row * 2)
    again = ca.logic_and(active, again)
    after = [ca.if_else(again, new, old) for new, old in zip(then, (f, column, row), strict=True)]
    return ca.Function("doubled", [x], [ca.vertcat(*after, again)]).fold(HALVINGS)


def _balance(x: Graph, scale: Graph) -> tuple[Graph, ...]:
    X, n = _rows(x), scale.numel()
    factors = [ca.MX(1)] * n
    for _ in range(SWEEPS):
        for i in range(n):
            column, row = _size(X[:, i], i), _size(X[i, :].T, i)
            both = ca.logic_and(column > 0, row > 0)
            f, column, row, _ = ca.vertsplit(_doubled(True)(ca.vertcat(1, column, row, both)))
            f, *_ = ca.vertsplit(_doubled(False)(ca.vertcat(f, column, row, both)))
            X = ca.vertcat(X[:i, :], X[i, :] / f, X[i + 1 :, :])
            X = ca.horzcat(X[:, :i], X[:, i] * f, X[:, i + 1 :])
            factors[i] = factors[i] * f
    return _flat(X), ca.vertcat(*factors)


def _product(a: Graph, b: Graph) -> Graph:
    return reduce(lambda total, k: total + a[:, k] @ b[k, :], range(1, a.shape[0]), a[:, 0] @ b[0, :])


@cache
def _halved(size: int) -> Graph:
    x = ca.SX.sym("x", 2 + size)
    over = x[0] > 0.5
    then = ca.vertcat(x[0] / 2, x[1] + 1, x[2:] / 2)
    after = (ca.if_else(over, then[k], x[k]) for k in range(2 + size))
    return ca.Function("halved", [x], [ca.vertcat(*after)]).fold(HALVINGS)


@cache
def _squared(n: int) -> Graph:
    """Return the function that maps (doublings, phi_0(X), phi_1(X), phi_2(X)) to phi_0, phi_1, phi_2 of 2^doublings
    X."""
    x, size = ca.SX.sym("x", 1 + 3 * n * n), n * n
    a0, a1, a2 = (ca.reshape(x[1 + k * size : 1 + (k + 1) * size], n, n) for k in range(3))
    next2, next1 = (_product(a0, a2) + a1 + a2) / 4, (_product(a0, a1) + a1) / 2
    after = ca.vertcat(x[0] - 1, *map(ca.vec, (_product(a0, a0), next1, next2)))
    again, still = ca.Function("again", [x], [after]), ca.Function("still", [x], [x])
    y = ca.MX.sym("y", 1 + 3 * size)
    once = ca.Function.if_else("doubling", again, still)
    return ca.Function("squared", [y], [once(y[0] > 0, y)]).fold(HALVINGS)


def _exponential(x: Graph, *_: Graph) -> tuple[Graph, ...]:
    n = int(np.sqrt(x.numel()))
    X = _rows(x)
    sizes = (_size(X[i, :].T, n) for i in range(n))
    norm = reduce(lambda a, b: ca.if_else(b > a, b, a), sizes)  # as Python's max has it
    halved = _halved(n * n)(ca.vertcat(norm, 0, ca.vec(X)))
    series = _series(n)(ca.reshape(halved[2:], n, n))
    squared = _squared(n)(ca.vertcat(halved[1], *map(ca.vec, series)))
    results = (ca.reshape(squared[1 + k * n * n : 1 + (k + 1) * n * n], n, n) for k in range(3))
    return x, *map(_flat, results)


@cache
def _series(n: int) -> Graph:
    """Return the function of X to phi_0 = e^X, phi_1 and phi_2,
    phi_k = sum_j X^j/(j + k)!, by Horner's scheme."""
    X, one = ca.SX.sym("X", n, n), ca.SX.eye(n)
    a2 = one
    for j in range(DEGREE, 0, -1):
        a2 = one + _product(X, a2) / (j + 2)
    a2 = a2 / 2
    a1 = one + _product(X, a2)
    return ca.Function("series", [X], [one + _product(X, a1), a1, a2])


def _resolvent(x: Graph, inverse: Graph) -> tuple[Graph, ...]:
    return tuple(map(_flat, _resolved(int(np.sqrt(x.numel())))(_rows(x))))


@cache
def _resolved(n: int) -> Graph:
    """Return the function of X to (the reduced 1 - X, its
    inverse) by Gauss-Jordan elimination with row pivots."""
    X, one = ca.SX.sym("X", n, n), ca.SX.eye(n)
    rows = [list(ca.vertsplit(matrix)) for matrix in (ca.densify(one - X), ca.densify(one))]
    A = rows[0]
    for k in range(n):
        best, largest = ca.SX(k), ca.fabs(A[k][k])
        for i in range(k + 1, n):
            size = ca.fabs(A[i][k])
            better = size > largest
            best, largest = ca.if_else(better, i, best), ca.if_else(better, size, largest)
        for each in rows:
            old = list(each)
            each[k] = reduce(lambda row, i, old=old: _row(best == i, old[i], row), range(k + 1, n), old[k])  # type: ignore[misc]
            each[k + 1 :] = [_row(best == i, old[k], old[i]) for i in range(k + 1, n)]
        pivot = A[k][k]
        for each in rows:
            each[k] = each[k] / pivot
        for i in range(n):
            factor = A[i][k]
            if i != k:
                for each in rows:
                    each[i] = each[i] - factor * each[k]
    return ca.Function("resolvent", [X], [ca.densify(ca.vertcat(*each)) for each in rows])


def _row(test: Graph, yes: Graph, no: Graph) -> Graph:
    return ca.horzcat(*(ca.if_else(test, yes[j], no[j]) for j in range(yes.numel())))


_ON_MATRICES: Mapping[str, Callable[..., tuple[Graph, ...]]] = {
    "balance": _balance,
    "exponential": _exponential,
    "resolvent": _resolvent,
}


_FREE = (ca.OP_INPUT, ca.OP_OUTPUT, ca.OP_CONST, ca.OP_PARAMETER, ca.OP_ASSIGN)
OPERATION, FUNCTION = -1, -2  # keys of a kernel's counts: an instruction, a square root
KERNEL = 20  # the length of a kernel's text in operations


def executed_operations(program: Sequence[Statement]) -> Counter[int]:
    """Return the number of times that one sample period executes each CasADi instruction, by the instruction's code:
    every section runs, a `When` takes its longer branch, a loop all its members."""
    return _Counting().program(program)


def text_operations(program: Sequence[Statement]) -> int:
    """Return the number of operations in the text of a program, where each statement counts once, also in the body of a
    loop."""
    kernels = sum(isinstance(statement, Kernel) for statement in walk(program))
    return sum(instructions_of(block.graph).total() for block in blocks(program)) + KERNEL * kernels


class _Counting(Reader[Counter[int]]):
    """A traversal of a program that counts the instructions of a sample period."""

    def joined(self, parts: Iterable[Counter[int]]) -> Counter[int]:
        return sum(parts, Counter())

    def _block(self, block: Block) -> Counter[int]:
        return instructions_of(block.graph)

    def _loop(self, loop: Loop) -> Counter[int]:
        return Counter({op: loop.count * times for op, times in self.program(loop.body).items()})

    def _when(self, when: When) -> Counter[int]:
        return max(self.program(when.body), self.program(when.otherwise), key=Counter.total)

    def _call(self, call: Call) -> Counter[int]:
        return self.program(call.section.program)

    def _copy(self, _: Copy) -> Counter[int]:
        return Counter()

    def _kernel(self, kernel: Kernel) -> Counter[int]:
        """Return the counts of instructions of a matrix kernel. An `add` counts as
        one update after the other, of 7 + 4 (s - 1) operations if s rows remain;
        the kernel computes two at a time, which share a few of these."""
        done: Counter[int] = Counter()
        if kernel.name == "add":
            return Counter({OPERATION: sum(s * (2 * s + 5) for s in range(1, kernel.size + 1))})

        def counted(*shape: int) -> np.ndarray:
            return np.array([_Counted(done) for _ in range(math.prod(shape))], dtype=object).reshape(shape)

        columns = [counted(kernel.size, kernel.size)] if kernel.columns else []
        KERNELS[kernel.name](*columns, *(counted(size) for _, size in kernel.arguments), *kernel.counts)
        return done


@lru_cache(maxsize=256)  # a routine is called at each stage, and both counts read every block
def instructions_of(graph: ca.Function) -> Counter[int]:
    """Return the number of each instruction in a graph and in the routines that it calls; instructions without cost do
    not count."""
    times = Counter(graph.instruction_id(k) for k in range(graph.n_instructions()))
    calls = (each for each in instructions(graph) if each.is_call())
    routines = [each for each in map(called, calls) if isinstance(each, ca.Function)]
    times[ca.OP_CALL] -= len(routines)
    times = Counter({op: count for op, count in times.items() if op not in _FREE and count})
    return sum(map(instructions_of, routines), times)


class _Counted:
    """A number without a value, larger than any other, so that the operations below conditions are counted."""

    def __init__(self, done: Counter[int]) -> None:
        self.done = done

    def _operation(self, other: Any) -> Any:
        if isinstance(other, np.ndarray):
            return NotImplemented  # numpy then calls element by element
        self.done[OPERATION] += 1
        return self

    def __gt__(self, _: Any) -> bool:
        self.done[OPERATION] += 1
        return True

    def __ge__(self, _: Any) -> bool:
        self.done[OPERATION] += 1
        return True

    def __le__(self, _: Any) -> bool:
        self.done[OPERATION] += 1
        return False

    def sqrt(self) -> "_Counted":
        """Return the root, counted as a function, that numpy's `sqrt` of an object calls."""
        self.done[FUNCTION] += 1
        return self

    __add__ = __radd__ = __sub__ = __rsub__ = __mul__ = __rmul__ = __truediv__ = __rtruediv__ = _operation
