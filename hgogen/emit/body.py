"""The body of a block or a function: the constants that it declares, and its statements."""

from collections.abc import Collection, Sequence
from itertools import islice

import casadi as ca

from hgogen.emit.code import Code, united
from hgogen.emit.looping import LoopPrinter
from hgogen.emit.node import ELEMENT, Node, ordered, read
from hgogen.emit.rolled import Statement, Target, rolled


def body(
    printer: LoopPrinter,
    function: ca.Function,
    targets: Sequence[Target],
    names: Sequence[tuple[str, int]],
    hoist: Collection[int],
) -> tuple[Code, Code]:
    """The constants that a block declares, and its statements.

    `targets`: for each element of the first outputs; `names`: of the outputs after those, with their sizes; `hoist`:
    arguments that must be read before anything is written.
    """
    nodes = [node for output in read(function) for node in output]
    pairs = [(n, t) for n, t in zip(nodes, targets, strict=False) if n.op != ca.OP_INPUT or n.source != t.source]
    named = nodes[len(targets) :]
    for node in ordered(nodes) if printer.routines else ():
        if node.routine:
            printer.arrange(node)
    statements = rolled(pairs, printer.goes_through, hoist, printer.least)
    roots = [statement.node for statement in statements]
    every = ordered(roots)
    printer.count(roots, every)
    _hoist(printer, every, hoist)
    rest = iter(named)
    columns = [(name, list(islice(rest, size))) for name, size in names]
    for name, column in columns:
        for node in (each for each in column if each.op == ELEMENT):
            node.args[0].labels.setdefault(node.element[0], name)
    for node in (each for each in every if each.routine):
        printer.label(node)
    for name, column in columns:
        _declare(printer, name, column)
    for node in roots:
        printer.prepare(node)
        if not node.name and not node.inside and node.op not in (ca.OP_CONST, ca.OP_INPUT) and node.uses > 1:
            printer.declare(node, printer.number())
    written = [line for statement in statements for line in _written(printer, statement)]
    uses = united(printer.uses)
    where = (target.uses for statement in statements for target in statement.targets)
    return Code(tuple(printer.lines), uses), Code(tuple(written), united([uses, *where]))


def _declare(printer: LoopPrinter, name: str, column: list[Node]) -> None:
    """Declare a value that has a name, element by element."""
    for k, node in enumerate(column):
        if node.op not in (ca.OP_CONST, ca.OP_INPUT) and node.uses and not node.name:
            printer.prepare(node)
            printer.declare(node, name if len(column) == 1 else f"{name}{k + 1}")


def _written(printer: LoopPrinter, statement: Statement) -> Sequence[str]:
    node, (target, *others) = statement.node, statement.targets
    if others:
        return printer.written(node, statement.targets)
    if not target.raised:
        return [target.write(printer.truth(node) if target.flag else printer.value(node))]
    if node.op == ca.OP_CONST:
        return [target.write("")] if node.constant else []
    return target.raised(printer.truth(node))


def _hoist(printer: LoopPrinter, every: list[Node], hoist: Collection[int]) -> None:
    """Declare the inputs that the block also writes, before anything is written."""
    inputs = {node.source: node for node in every if node.op == ca.OP_INPUT and node.source[0] in hoist}
    for source in sorted(inputs):
        printer.declare(inputs[source], printer.local(*source))
