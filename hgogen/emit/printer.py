"""The printer: a block's SX instructions as readable text in a `Syntax`, with named values and few parentheses.

The order of operations in the text is that of the instructions, except that operands of + and * may be exchanged, so
every reader of a block computes the same bits (where the compiler does not contract a*b + c). Values that are used more
than once, or have a name, become constant locals; others are written in place. Loops fill arrays, accumulate sums, and
write elements (`emit.rolled`).
"""

from collections import Counter
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from itertools import chain, islice

import casadi as ca

from hgogen.emit.code import NOTHING, TRUTH, Code, Uses, indented, united
from hgogen.emit.node import (
    ARRAY,
    AT,
    CALLS,
    CHOOSE,
    CLAMP,
    ELEMENT,
    FILL,
    FOLD,
    INFIX,
    LOGIC,
    PATTERNS,
    TABLE,
    Node,
    Subprogram,
    boolean,
    negated,
    negative,
    opposite,
    ordered,
    read,
)
from hgogen.emit.rolled import Statement, Target, outside, rolled
from hgogen.emit.syntax import ATOM, OR, ORDER, PRODUCT, SELECT, SUM, UNARY, NotPrintable, Number, Syntax

WIDTH = 92  # of the longest expression in place
LEAST = {"speed": 10, "flash": 4}  # passes of a loop at least, by the preference of a step
NEVER = 10**9  # passes: no loop is made


def _binding(node: Node) -> float:
    if node.name or node.op in (ELEMENT, AT):
        return ATOM
    if node.op in (CHOOSE, ca.OP_IF_ELSE_ZERO) or boolean(node):
        return SELECT
    return INFIX[node.op][1] if node.op in INFIX else UNARY


@dataclass(frozen=True)
class Operand:
    """A value that a printed expression reads: its text, the precedence `binds` of that text, whether it is a local
    variable, and the names that the text uses."""

    text: str
    binds: float = ATOM
    local: bool = True
    uses: Uses = NOTHING


@dataclass
class Printer:
    """A printer of one block (a CasADi function) of a step's program as statements of a language.

    Args: `inputs` the operand for element j of argument i, and `local` the name of a local variable for it; `is_flag`
    whether argument i is a truth value; `routines` those that the block may call, by their keys; `array_text` the text
    of argument i as an array, and its size; `indexed` the same text if a loop can index the argument, otherwise "";
    `least` the smallest number of passes for which a loop is written; `interval_calls` whether a test low <= v <= high
    is a function call, which lowers the cyclomatic complexity. While it prints, `uses` collects the names that the text
    uses; `looping` says whether a loop is open, and `origin` is the first value of its counter.
    """

    syntax: Syntax
    real: Number
    prefix: str
    inputs: Callable[[int, int], Operand]
    local: Callable[[int, int], str]
    is_flag: Callable[[int], bool] = lambda _: False
    calls: Mapping[int, str] = field(default_factory=lambda: CALLS)
    routines: Mapping[str, Subprogram] = field(default_factory=dict)
    array_text: Callable[[int], tuple[str, int]] = lambda _: ("", 0)
    called: Counter[str] = field(default_factory=Counter)
    uses: list[Uses] = field(default_factory=list)
    lines: list[str] = field(default_factory=list)
    reserved: set[str] = field(default_factory=set)
    indexed: Callable[[int], str] = lambda _: ""
    least: int = LEAST["speed"]
    looping: bool = False
    origin: int = 0
    passed: Counter[str] = field(default_factory=Counter)
    interval_calls: bool = False

    def body(
        self,
        function: ca.Function,
        targets: Sequence[Target],
        names: Sequence[tuple[str, int]] = (),
        hoist: Collection[int] = (),
    ) -> tuple[Code, Code]:
        """Return the declarations of a block's local constants, and the statements that compute a CasADi function.

        Args: `targets` where each element of the first outputs is written; `names` and sizes of the further outputs,
        which only name intermediate values; `hoist` arguments that must be read before anything is written.
        """
        nodes = [node for output in read(function, self.interval_calls) for node in output]
        pairs = [(n, t) for n, t in zip(nodes, targets, strict=False) if n.op != ca.OP_INPUT or n.source != t.source]
        remaining = iter(nodes[len(targets) :])
        columns = [(name, list(islice(remaining, size))) for name, size in names]
        for call in [node for node in ordered(nodes) if node.routine] if self.routines else ():
            self.arrange(call)
        statements = rolled(pairs, self.can_index, hoist, self.least)
        roots = [statement.node for statement in statements]
        all_nodes = ordered(roots)
        for used in chain(roots, (child for node in all_nodes for child in node.args)):
            used.uses += 1
        inputs = {node.source: node for node in all_nodes if node.op == ca.OP_INPUT and node.source[0] in hoist}
        for source in sorted(inputs):
            self.declare(inputs[source], self.local(*source))
        self._label(columns, all_nodes)
        for name, column in columns:
            self._declare_named(name, column)
        for node in roots:
            self.prepare(node)
            if not node.name and not node.inside and node.op not in (ca.OP_CONST, ca.OP_INPUT) and node.uses > 1:
                self.declare(node, self.number())
        written = [line for statement in statements for line in self._written(statement)]
        where = (target.uses for statement in statements for target in statement.targets)
        uses = united(self.uses)
        return Code(tuple(self.lines), uses), Code(tuple(written), united([uses, *where]))

    def _label(self, columns: Iterable[tuple[str, list[Node]]], all_nodes: Iterable[Node]) -> None:
        for name, column in columns:
            for node in (each for each in column if each.op == ELEMENT):
                node.args[0].labels.setdefault(node.element[0], name)
        for call in (each for each in all_nodes if each.routine):
            assert call.routine
            key = call.routine.key
            self.passed[key] += 1
            for each, elements in zip(self.routines[key].passed, call.passed, strict=True):
                for node in elements:
                    if node.op == ELEMENT and node.args[0].op == FILL:
                        node.args[0].labels.setdefault(0, f"{each.argument.label}_{self.passed[key]}")

    def _declare_named(self, name: str, column: list[Node]) -> None:
        for k, node in enumerate(column):
            if node.op not in (ca.OP_CONST, ca.OP_INPUT) and node.uses and not node.name:
                self.prepare(node)
                self.declare(node, name if len(column) == 1 else f"{name}{k + 1}")

    def _written(self, statement: Statement) -> Sequence[str]:
        node, (target, *others) = statement.node, statement.targets
        if others:
            first, step, each = target.element, others[0].element - target.element, target.each
            assert each
            origin, count = first if step == 1 else 0, len(statement.targets)
            return self._loop(count, origin, node, lambda: each(self._number(first, step), self.value(node)))
        if not target.raised:
            return [target.write(self.truth(node) if target.flag else self.value(node))]
        if node.op == ca.OP_CONST:
            return [target.write("")] if node.constant else []
        return target.raised(self.truth(node))

    @cached_property
    def counter(self) -> str:
        """The name of the counter of the block's loops."""
        return self.fresh("j")

    def can_index(self, argument: int) -> bool:
        """Return whether a loop may index argument number `argument`; blocks that compute in counters have no loops."""
        return self.real != "unsigned" and bool(self.indexed(argument))

    def declare(self, node: Node, name: str) -> None:
        """Declare a local constant for the value of a node, under a unique name that begins with `name`."""
        if node.name or node.op in (ca.OP_CONST, ELEMENT):
            return
        if node.routine:
            self.call_routine(node)
            return
        if node.op in (FILL, FOLD, TABLE):
            self._declare_looped(node, name)
            return
        text, _ = self.raw(node)
        node.name = self.fresh(name)
        kind = "bool" if self.true_or_false(node) else self.real
        self.uses += [TRUTH] if kind == "bool" else []
        self.lines.append(self.syntax.constant.format(type=self.syntax.types[kind], name=node.name, value=text))

    def true_or_false(self, node: Node) -> bool:
        """Return whether the printed type of a node is the language's type of truth values."""
        flag = node.op == ca.OP_INPUT and self.is_flag(node.source[0])
        return boolean(node) or (flag and not self.syntax.truth_is_number)

    def fresh(self, name: str) -> str:
        """Return `name` as an unused name of a local variable: changed if the language reserves it, numbered if another
        local has it."""
        candidate, k = self.syntax.name(name), 2
        while candidate in self.reserved:
            candidate, k = f"{name}_{k}", k + 1
        self.reserved.add(candidate)
        return candidate

    def _declare_looped(self, node: Node, name: str) -> None:
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

    def _loop(self, count: int, origin: int, node: Node, statement: Callable[[], str]) -> list[str]:
        before, self.lines, self.origin, self.looping = self.lines, [], origin, True
        self.prepare(node)
        inner, self.lines, self.looping = [*self.lines, statement()], before, False
        first, end = map(self.syntax.number, (origin, origin + count))
        self.uses.append(Uses(widest=origin + count))
        head, *first_lines = self.syntax.loop(self.counter, first, end, "", True)
        return [head, *indented([*first_lines, *inner]), "}"]

    def _number(self, first: int, step: int) -> str:
        first -= step * self.origin
        size = self.syntax.number(abs(step))
        offset = self.counter if abs(step) == 1 else f"{size}*{self.counter}"
        if step < 0:
            return f"{self.syntax.number(first)} - {offset}"
        sign = " + " if first > 0 else " - "
        return f"{offset}{sign}{self.syntax.number(abs(first))}" if first else offset

    def prepare(self, root: Node) -> None:
        """Declare local constants for the operands of a node. If the node's value changes from pass to pass of a loop,
        declare only those operands that are computed before the loop."""
        if root.inside and not self.looping:
            for node in outside([root]):
                self.prepare(node)
                self.declare_worthy(node)
        else:
            self._prepare_below(root)
        if root.op == FOLD:
            self.declare(root, self.number())

    def _prepare_below(self, root: Node) -> None:
        stack: list[tuple[Node, bool]] = [(root, False)]
        done: set[int] = set()
        while stack:
            node, ready = stack.pop()
            if node.name or id(node) in done:
                continue
            if not ready:
                stack.append((node, True))
                stack.extend((child, False) for child in reversed(self.needs(node)))
                continue
            done.add(id(node))
            repeated = not node.routine and any(a is b for i, a in enumerate(node.args) for b in node.args[i + 1 :])
            for child in node.args:
                if repeated and child.op not in (ca.OP_CONST, ca.OP_INPUT) and not child.name:
                    self.declare(child, self.number())
            if node is not root:
                self.declare_worthy(node)

    def declare_worthy(self, node: Node) -> None:
        """Declare a local constant for a node that is used more than once, or whose text is long."""
        if self.worthy(node):
            self.declare(node, self.local(*node.source) if node.op == ca.OP_INPUT else self.number())

    def needs(self, node: Node) -> Sequence[Node]:
        """Return the nodes that must be declared before a node; for the result of a loop, those that are computed
        before the loop."""
        if self.looping:
            return node.args if node.inside else ()
        return outside(node.args) if node.op in (FILL, FOLD) else node.args

    def number(self) -> str:
        """Return the name of the next temporary variable."""
        k = 1
        while f"t{k}" in self.reserved:
            k += 1
        return f"t{k}"

    def worthy(self, node: Node) -> bool:
        """Return whether a node is declared as a local constant, instead of being written within the expression that
        uses it."""
        if node.op in (ca.OP_CONST, ca.OP_NOT, ELEMENT, ARRAY, AT):
            return False
        if node.routine or node.op in (FILL, FOLD, TABLE):
            return True
        if node.op == ca.OP_INPUT:
            return node.uses > 1 and not self.inputs(*node.source).local
        if node.op == ca.OP_NEG and node.args[0].name:
            return False
        return node.uses > 1 or len(self.raw(node)[0]) > WIDTH

    def value(self, node: Node, level: float = 0) -> str:
        """Return the text of a node as a number, in parentheses if its precedence is below `level`."""
        if self.true_or_false(node):
            one, zero = Node(ca.OP_CONST, constant=1.0), Node(ca.OP_CONST)
            text, binds = self.choice(node, one, zero, OR)
        else:
            text, binds = (node.name, ATOM) if node.name else self.raw(node)
        return f"({text})" if binds < level else text

    def truth(self, node: Node, level: float = 0) -> str:
        """Return the text of a node as a truth value, in parentheses if its precedence is below `level`."""
        if boolean(node):
            text, binds = (node.name, ATOM) if node.name else self.raw(node)
        elif node.op == ca.OP_INPUT and self.is_flag(node.source[0]):
            text, binds = node.name or self.raw(node)[0], ATOM
        elif node.op == ca.OP_CONST:
            self.uses.append(TRUTH)
            text, binds = ("true" if node.constant else "false"), ATOM
        else:
            text, binds = self.infix(ca.OP_NE, node, Node(ca.OP_CONST))
        return f"({text})" if binds < level else text

    def clause(self, node: Node, op: int) -> str:
        """Return the text of an operand of `op` (&& or ||), in parentheses unless the operand is a comparison or has
        the same `op`."""
        same = node.op == op or node.op in (ca.OP_NOT, ca.OP_LT, ca.OP_LE, ca.OP_EQ, ca.OP_NE)
        return self.truth(node, 0 if same else ATOM)

    def literal(self, value: float) -> str:
        """Return the text of a number in the working precision."""
        text = self.syntax.literal(value, self.real)
        self.uses += [Uses(widest=int(value))] if self.real == "unsigned" else []
        return text

    def constant(self, value: float) -> tuple[str, float]:
        """Return the text and the precedence of a constant: a literal, or a call of a helper for inf and nan."""
        if value != value:
            return self.call("nan")
        if abs(value) == float("inf"):
            text, _ = self.call("inf")
            return (text, ATOM) if value > 0 else (f"-{text}", UNARY)
        return self.literal(value), ATOM if value >= 0 else UNARY

    def call(self, name: str, *args: Node) -> tuple[str, float]:
        """Return the text and the precedence of a call of the helper or elementary function `name`."""
        self.uses.append(Uses(helpers=frozenset({name})))
        return f"{self.prefix}_{name}({', '.join(self.value(a) for a in args)})", ATOM

    def arrange(self, call: Node) -> None:
        """Set the arguments that a call of a routine passes: the elements of each argument one by one, or an array with
        exactly these elements."""
        assert call.routine
        columns = list[tuple[Node, ...]]()
        for each, column in self.routines[call.routine.key].columns(call):
            columns.append(tuple(column))
            if not each.by_value:
                first, _ = column[0].source
                lies = all(n.op == ca.OP_INPUT and n.source == (first, k) for k, n in enumerate(column))
                if lies and self.array_text(first)[1] == len(column):
                    columns[-1] = (Node(ARRAY, source=(first, 0)),)
        call.passed = tuple(columns)
        call.args = tuple(chain.from_iterable(call.passed))

    def call_routine(self, node: Node) -> None:
        """Add the statements that call a routine, and declare an array for each of its results."""
        assert node.routine
        subprogram, key = self.routines[node.routine.key], node.routine.key
        self.called[key] += 1
        texts = list[str]()
        for each, column in zip(subprogram.passed, node.passed, strict=True):
            name = f"{each.argument.label}_{self.called[key]}"
            texts += map(self.value, column) if each.by_value else [self._by_reference(name, column)]
        for result, (name, size) in enumerate(node.routine.results):
            node.labels[result] = self.fresh(node.labels.get(result, f"{name}_{self.called[key]}"))
            self.lines.append(self._array(self.syntax.array, node.labels[result], size, value=self.literal(0)))
        node.name = subprogram.name
        params = [self.syntax.parameters.get("p", "p")] * subprogram.reads_parameters
        results = map(self.syntax.passed[True].format, node.labels.values())
        self.lines.append(f"{self.prefix}_{subprogram.name}({', '.join((*params, *texts, *results))});")
        self.uses.append(Uses(parameters=frozenset("p" * subprogram.reads_parameters), routines=frozenset({key})))

    def _by_reference(self, name: str, column: Sequence[Node]) -> str:
        first = column[0]
        by_read = self.syntax.passed[False].format
        if first.op == ARRAY:
            self.uses.append(self.inputs(*first.source).uses)
            return by_read(self.array_text(first.source[0])[0])
        if all(n.op == ELEMENT and n.args == first.args and n.element[1] == k for k, n in enumerate(column)):
            (call,), (result, _) = first.args, first.element
            size = call.routine.results[result][1] if call.routine else call.count
            if {n.element[0] for n in column} == {result} and size == len(column):
                return by_read(call.labels[result])
        values, name = ", ".join(map(self.value, column)), self.fresh(name)
        self.lines.append(self._array(self.syntax.gathered, name, len(column), values=values))
        return by_read(name)

    def _array(self, text: str, name: str, size: int, **words: str) -> str:
        count = self.syntax.literal(size, "unsigned")
        return text.format(type=self.syntax.types[self.real], name=name, size=size, count=count, **words)

    def raw(self, node: Node) -> tuple[str, float]:
        """Return the text of a node, composed of its operands' texts, and the precedence of the text."""
        op, args = node.op, node.args
        if op in (ca.OP_CONST, ca.OP_INPUT, ELEMENT, AT):
            return self._leaf(node)
        if op in (CHOOSE, ca.OP_IF_ELSE_ZERO, ca.OP_NOT, *LOGIC):
            return self._logical(node)
        if op == CLAMP and opposite(*args[1:]):
            return self.call("limit", args[0], args[2])
        if op in PATTERNS:
            return self.call(PATTERNS[op], *args)
        if op == ca.OP_NEG:
            return f"-{self.value(args[0], ATOM)}", UNARY
        if op in (ca.OP_LT, ca.OP_LE) and args[0].op == ca.OP_CONST:
            sign = " > " if op == ca.OP_LT else " >= "
            return f"{self.value(args[1], ORDER + 0.1)}{sign}{self.value(args[0], ORDER + 0.1)}", ORDER
        if op in INFIX:
            return self.infix(op, *args)
        if node.lookup:
            self.uses.append(Uses(lookups=frozenset({node.lookup})))
            return f"{self.prefix}_{node.lookup.name}({', '.join(map(self.value, args))})", ATOM
        if op in self.calls:
            return self.call(self.calls[op], *args)
        raise NotPrintable(op)

    def _leaf(self, node: Node) -> tuple[str, float]:
        if node.op == ca.OP_CONST:
            return self.constant(node.constant)
        if node.op == ca.OP_INPUT:
            operand = self.inputs(*node.source)
            self.uses.append(operand.uses)
            return operand.text, operand.binds
        if node.op == AT:
            return self._moving(node), ATOM
        result, k = node.element
        return f"{node.args[0].labels[result]}[{k}]", ATOM

    def _logical(self, node: Node) -> tuple[str, float]:
        op, args = node.op, node.args
        if op == ca.OP_NOT:
            return self.negation(args[0])
        if op in LOGIC:
            sign = self.syntax.both if op == ca.OP_AND else self.syntax.either
            return sign.join(self.clause(arg, op) for arg in args), LOGIC[op]
        test, yes, no = args if op == CHOOSE else (*args, Node(ca.OP_CONST))
        return self.choice(test, yes, no)

    def _moving(self, node: Node) -> str:
        if node.args:
            result, first = node.element
            return f"{node.args[0].labels[result]}[{self._number(first, node.step)}]"
        argument, first = node.source
        self.uses.append(self.inputs(argument, first).uses)
        return f"{self.indexed(argument)}[{self._number(first, node.step)}]"

    def choice(self, test: Node, yes: Node, no: Node, level: float = ATOM) -> tuple[str, float]:
        """Return the text and precedence of the selection: `yes` where `test` holds, else `no`. A negated test is
        printed positive, with the two branches exchanged."""
        if test.op == ca.OP_NOT and not test.name and level == ATOM:
            test, yes, no = test.args[0], no, yes
        tested, chosen = self.syntax.chosen
        branches = {"yes": self.value(yes, chosen), "no": self.value(no, chosen)}
        return self.syntax.choice.format(test=self.truth(test, min(level, tested)), **branches), SELECT

    def negation(self, test: Node) -> tuple[str, float]:
        """Return the text and precedence of `not test`; for counters, which are never NaN, by the opposite
        comparison."""
        opposite = {ca.OP_LT: ca.OP_LE, ca.OP_LE: ca.OP_LT, ca.OP_EQ: ca.OP_NE, ca.OP_NE: ca.OP_EQ}
        if self.real == "unsigned" and test.op in opposite and not test.name:
            swapped = test.op in (ca.OP_LT, ca.OP_LE)
            return self.raw(Node(opposite[test.op], test.args[::-1] if swapped else test.args))
        return self.syntax.opposite.format(self.truth(test, ATOM)), UNARY

    def infix(self, op: int, left: Node, right: Node) -> tuple[str, float]:
        """Return the text `left op right` of a binary operation, and its precedence.

        The order of operations is part of the result, so a right operand that binds as loosely needs parentheses. The
        operands of a sum or product, which commutes bit for bit, are exchanged to save them.
        """
        sign, binds = INFIX[op]
        if op in (ca.OP_EQ, ca.OP_NE) and self.syntax.equal and self.real != "unsigned":
            text, binds = self.call("equal", left, right)
            return (text, binds) if op == ca.OP_EQ else (self.syntax.opposite.format(text), UNARY)
        if self.real == "unsigned" and op in self.syntax.counted:
            return self.syntax.counted[op].format(self.value(left, ATOM), self.value(right)), ATOM
        if op in (ca.OP_ADD, ca.OP_MUL):
            turned = op == ca.OP_ADD and negative(left) and not negative(right)
            if turned or (_binding(right) == binds < _binding(left)):
                left, right = right, left
        if op in (ca.OP_ADD, ca.OP_SUB) and negative(right):
            sign, right = " - " if op == ca.OP_ADD else " + ", negated(right)
        text = f"{self.value(left, binds)}{sign}{self.value(right, binds + 0.1)}"
        if self.real in self.syntax.rounded and binds in (SUM, PRODUCT):
            return self.syntax.rounded[self.real].format(text), ATOM
        return text, binds
