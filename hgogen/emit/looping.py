"""The printer of what loops compute: arrays that they fill, sums that they make grow, elements that they write."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import cached_property

from hgogen.emit.code import TRUTH, Uses, indented
from hgogen.emit.node import AT, ELEMENT, FILL, FOLD, TABLE, Node, boolean
from hgogen.emit.printer import Printer
from hgogen.emit.rolled import Target, outside
from hgogen.emit.syntax import ATOM

LEAST = {"speed": 10, "flash": 4}  # times that a loop runs at least, by what a step is made for
NEVER = 10**9  # times: no loop is made


@dataclass
class LoopPrinter(Printer):
    """Prints one block with loops; `indexed`: the text of an argument whose elements a loop can go through, else "".

    `least`: how often a loop runs at least; `looping`: whether a loop is at hand; `origin`: the first number that it
    counts."""

    indexed: Callable[[int], str] = lambda _: ""
    least: int = LEAST["speed"]
    looping: bool = False
    origin: int = 0
    passed: dict[str, int] = field(default_factory=dict)

    @cached_property
    def counter(self) -> str:
        """What loops count by."""
        return self.fresh("j")

    def goes_through(self, argument: int) -> bool:
        """Whether a loop can go through the elements of an argument; counters are left alone."""
        return self.real != "unsigned" and bool(self.indexed(argument))

    def label(self, call: Node) -> None:
        """Name the arrays that a routine is passed as its arguments, with the number of the call."""
        assert call.routine
        subprogram, key = self.routines[call.routine.key], call.routine.key
        self.passed[key] = self.passed.get(key, 0) + 1
        for each, column in zip(subprogram.passed, call.passed, strict=True):
            for node in column:
                if node.op == ELEMENT and node.args[0].op == FILL:
                    node.args[0].labels.setdefault(0, f"{each.argument.label}_{self.passed[key]}")

    def prepare(self, root: Node) -> None:
        """Declare what a value needs; of what is another each time that a loop runs, what the loop needs."""
        if root.inside and not self.looping:
            for node in outside([root]):
                self.prepare(node)
                self.declare_worthy(node)
        else:
            super().prepare(root)
        if root.op == FOLD:
            self.declare(root, self.number())

    def needs(self, node: Node) -> Sequence[Node]:
        """What is declared before a value; what a loop needs, before the loop."""
        if self.looping:
            return node.args if node.inside else ()
        return outside(node.args) if node.op in (FILL, FOLD) else node.args

    def worthy(self, node: Node) -> bool:
        """What a loop computes is declared; the element at which it is has a text of its own."""
        return node.op in (FILL, FOLD, TABLE) or (node.op != AT and super().worthy(node))

    def declare(self, node: Node, name: str) -> None:
        """A value; what a loop computes, with the loop."""
        if node.op not in (FILL, FOLD, TABLE) or node.name:
            super().declare(node, name)
            return
        name = node.name = self.fresh(node.labels.get(0, name))
        node.labels[0] = name
        if node.op == FOLD:
            self._folded(node, name)
        elif node.op == FILL:
            (element,) = node.args
            self.lines.append(self._array(self.syntax.array, name, node.count, value=self.literal(0)))
            self.lines += self._loop(node.count, 0, element, lambda: f"{name}[{self.counter}] = {self.value(element)};")
        else:
            values = ", ".join(map(self.literal, node.table))
            self.lines.append(self._array(self.syntax.fixed, name, len(node.table), values=values))

    def _folded(self, node: Node, name: str) -> None:
        first, term = node.args
        logic = boolean(node)
        kind, text = ("bool", self.truth(first)) if logic else (self.real, self.value(first))
        self.uses += [TRUTH] if logic else []
        self.lines.append(self.syntax.variable.format(type=self.syntax.types[kind], name=name, value=text))
        total = Node(node.fold, (Node(FOLD, fold=node.fold, name=name), term))
        self.lines += self._loop(node.count, 0, term, lambda: f"{name} = {self.raw(total)[0]};")

    def written(self, node: Node, targets: Sequence[Target]) -> list[str]:
        """A loop that writes elements of an array."""
        first, step, each = targets[0].element, targets[1].element - targets[0].element, targets[0].each
        assert each
        origin = first if step == 1 else 0
        return self._loop(len(targets), origin, node, lambda: each(self._number(first, step), self.value(node)))

    def _loop(self, count: int, origin: int, node: Node, statement: Callable[[], str]) -> list[str]:
        """A loop for a value, with the constants that it declares for it, which counts from `origin`."""
        before, self.lines, self.origin, self.looping = self.lines, [], origin, True
        self.prepare(node)
        inner, self.lines, self.looping = [*self.lines, statement()], before, False
        first, end = map(self.syntax.number, (origin, origin + count))
        self.uses.append(Uses(widest=origin + count))
        head, *rest = self.syntax.loop(self.counter, first, end, "", True)
        return [head, *indented([*rest, *inner]), "}"]

    def _number(self, first: int, step: int) -> str:
        """The text of the number that is the first where the loop begins, and goes on by steps."""
        first -= step * self.origin
        size = self.syntax.number(abs(step))
        moved = self.counter if abs(step) == 1 else f"{size}*{self.counter}"
        if step < 0:
            return f"{self.syntax.number(first)} - {moved}"
        sign = " + " if first > 0 else " - "
        return f"{moved}{sign}{self.syntax.number(abs(first))}" if first else moved

    def raw(self, node: Node) -> tuple[str, float]:
        """The text of a value; of the element at which a loop is, by its number."""
        if node.op != AT:
            return super().raw(node)
        if node.args:
            result, first = node.element
            return f"{node.args[0].labels[result]}[{self._number(first, node.step)}]", ATOM
        argument, first = node.source
        self.uses.append(self.inputs(argument, first).uses)
        return f"{self.indexed(argument)}[{self._number(first, node.step)}]", ATOM
