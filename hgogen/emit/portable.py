"""Functions that are written once and printed in a `Syntax`: small ones, matrix kernels, tables, mathematical ones.

Small functions and kernels are Python in the words of `discretisation.notation`. A docstring without a full stop is
printed above its function; one with it is for the reader of the file.

The mathematical functions are the graphs of `emit.elementary`: they give the same bits wherever the arithmetic is that
of IEEE 754 and rounds every operation to the working precision. In C a switch selects those of the C library, or of
CMSIS-DSP.
"""

import ast
import inspect
from collections.abc import Collection, Iterable, Mapping
from copy import deepcopy
from dataclasses import dataclass, field
from functools import cache
from types import ModuleType

import casadi as ca

from hgogen.discretisation import kernels as matrix_loops
from hgogen.discretisation.notation import sizes
from hgogen.emit import helpers
from hgogen.emit.code import TRUTH, Code, Uses, braced, code, joined, spaced, united
from hgogen.emit.elementary import ALL_WHOLE, ARITHMETIC, BIASED, POWER_OF_TWO, ROUNDS, SHIFT, elementary
from hgogen.emit.node import CALLS
from hgogen.emit.printer import Operand, Printer
from hgogen.emit.rolled import Target
from hgogen.emit.syntax import AND, ATOM, EQUAL, OR, ORDER, PRODUCT, SELECT, SUM, UNARY, Real, Syntax, demand_apart
from hgogen.rigor.lookup import Lookup

_LARGE: Mapping[Real, str] = {"float": "3e38", "double": "1e308"}
_ARRAYS = {  # by annotation: the number of elements, and whether the function may write them
    "Vector": ("n", True),
    "FixedVector": ("n", False),
    "Matrix": ("square", True),
    "FixedMatrix": ("square", False),
    "Columns": ("n", True),
    "FixedColumns": ("n", False),
}
_NUMBERS = {"float": "real", "bool": "bool", "None": "void"}
_INFIX: Mapping[type, tuple[str, float]] = {
    ast.Add: (" + ", SUM),
    ast.Sub: (" - ", SUM),
    ast.Mult: ("*", PRODUCT),
    ast.Div: ("/", PRODUCT),
    ast.FloorDiv: ("/", PRODUCT),  # of counts
    ast.Mod: (" % ", PRODUCT),
    ast.Lt: (" < ", ORDER),
    ast.LtE: (" <= ", ORDER),
    ast.Gt: (" > ", ORDER),
    ast.GtE: (" >= ", ORDER),
    ast.Eq: (" == ", EQUAL),
    ast.NotEq: (" != ", EQUAL),
}
Text = tuple[str, float]  # a text, and how tightly it binds
NO_CODE = Code()


@cache
def functions_of(module: ModuleType) -> Mapping[str, ast.FunctionDef]:
    """Return the syntax trees of a Python module's functions by name, in the order of the file."""
    tree = ast.parse(inspect.getsource(module))
    return {node.name: node for node in tree.body if isinstance(node, ast.FunctionDef)}


def small_functions(syntax: Syntax, prefix: str, real: Real, names: Collection[str]) -> Code:
    """Return the functions of `emit.helpers` with these names, translated from Python into the language of `syntax`."""
    definitions = functions_of(helpers)
    numbers = {"ALL_WHOLE": ALL_WHOLE[real], "ROUNDS": ROUNDS[real]}
    reals = {"LARGE": syntax.marked(_LARGE[real], real)}
    reals |= {name: syntax.literal(number, real) for name, number in numbers.items()}
    words = _Words(syntax, prefix, real, definitions, reals, {"int": syntax.types[f"whole {real}"]})
    return joined(_Function(words, definitions[name]).text() + code("") for name in definitions if name in names)


def tables(syntax: Syntax, prefix: str, real: Real, lookups: Iterable[Lookup]) -> Code:
    """Return the functions that interpolate in a model's tables, sorted by name, in the language of `syntax`."""
    return joined(_table(syntax, prefix, real, each) for each in sorted(lookups, key=lambda each: each.name))


def _table(syntax: Syntax, prefix: str, real: Real, lookup: Lookup) -> Code:
    demand_apart(lookup, real)
    definitions = functions_of(helpers)
    declared = Code()
    for name, numbers in lookup.arrays.items():
        values = ", ".join(syntax.literal(number, real) for number in numbers)
        declared += code(syntax.fixed.format(type=syntax.types[real], name=name, size=len(numbers), values=values))
    arguments = ", ".join(f"{axis.name}: float" for axis in lookup.axes)
    steps = "".join(f" {line}\n" for line in (*lookup.flattened, f"return {lookup.formula('0.0')}"))
    (tree,) = ast.parse(f"def {lookup.name}({arguments}) -> float:\n{steps}").body
    assert isinstance(tree, ast.FunctionDef)
    searches = list[ast.stmt]()
    for axis in lookup.axes:
        names = {"x": axis.name, "start": axis.array, "k": axis.cell}
        counts = {"n": len(axis.breaks), "FIRST": axis.probes[0]}
        *statements, last = _Renamed(names, counts).visit(deepcopy(definitions["search"])).body
        searches += [*statements, ast.Assign([ast.Name(axis.distance, ast.Store())], last.value)]
    tree.body = [*searches, *tree.body]
    words = _Words(syntax, prefix, real, definitions, {}, {})
    return code(syntax.comment(lookup.comment)) + _Function(words, tree).text(declared) + code("")


class _Renamed(ast.NodeTransformer):
    """A transformer of Python syntax trees that replaces names by other names, or by numbers."""

    def __init__(self, names: Mapping[str, str], counts: Mapping[str, int]) -> None:
        self.names, self.counts = names, counts

    def visit_Name(self, node: ast.Name) -> ast.expr:
        if node.id in self.counts:
            return ast.Constant(self.counts[node.id])
        return ast.Name(self.names.get(node.id, node.id), node.ctx)


def chosen(syntax: Syntax, real: Real, name: str, body: Code) -> Code:
    """Return the body of a helper function: translated from Python, or as the language writes it; both where a
    preprocessor switch selects one."""
    if name not in syntax.instead:
        return body.indented()
    switch, *lines = syntax.instead[name]
    word = syntax.types.get(f"word {real}", "")
    words = {"type": syntax.types[real], "suffix": syntax.suffixes[real], "word": word, "SHIFT": SHIFT[real]}
    words |= {"ROUNDS": syntax.literal(ROUNDS[real], real), "BIASED": syntax.literal(BIASED[real], real)}
    uses = Uses(types=frozenset({word} if any("{word}" in line for line in lines) else ()))
    other = Code(tuple(line.format(**words) for line in lines), uses).indented()
    if not switch:
        return other
    return code(f"#if {switch}") + other + code("#else") + body.indented() + code("#endif")


def called_by(names: Iterable[str]) -> set[str]:
    """Return the `names`, and the names of the functions of `emit.helpers` that these functions call, directly or
    indirectly."""
    return set(names).union(*(_calls(functions_of(helpers), name) for name in names))


def kernels(syntax: Syntax, prefix: str, real: Real, used: Collection[tuple[str, int]]) -> Code:
    """Return the functions of the matrix kernels in `used`, pairs (name, matrix size), in the order of their file,
    after the helpers that the kernels call."""
    definitions, written = functions_of(matrix_loops), []
    for kernel in definitions:
        for size in sorted(size for name, size in used if name == kernel):
            words = _Words(syntax, prefix, real, definitions, {}, {}, sizes(size))
            names = (*sorted(_calls(definitions, kernel)), kernel)
            written += [_Function(words, definitions[name]).text() for name in names]
    return joined(each + code("") for each in written)


def passed(syntax: Syntax, kernel: str) -> list[str]:
    """Return for each argument of a matrix kernel a text with a hole {} for that argument in a call: an array's name or
    a number."""
    kinds = (_array(each) for each in functions_of(matrix_loops)[kernel].args.args)
    return [syntax.passed[kind[1]] if kind else "{}" for kind in kinds]


def _calls(definitions: Mapping[str, ast.FunctionDef], name: str) -> set[str]:
    if name not in definitions:
        return set()
    nodes = (node.func for node in ast.walk(definitions[name]) if isinstance(node, ast.Call))
    direct = {node.id for node in nodes if isinstance(node, ast.Name)} & set(definitions)
    return direct.union(*(_calls(definitions, other) for other in direct))


def writes(parameter: ast.arg) -> bool:
    """Return whether a parameter of a Python function is an array that the function may write."""
    kind = _array(parameter)
    return kind is not None and kind[1]


def _array(parameter: ast.arg) -> tuple[str, bool] | None:
    return _ARRAYS.get(_annotation(parameter.annotation))


def _kind_of(parameter: ast.arg) -> str:
    kinds = {"int": "index", "bool": "bool"}
    return "array" if _array(parameter) else kinds.get(_annotation(parameter.annotation), "real")


def _annotation(node: ast.expr | None) -> str:
    return ast.unparse(node) if node else ""


@dataclass(frozen=True)
class _Words:
    syntax: Syntax
    prefix: str
    real: Real
    functions: Mapping[str, ast.FunctionDef]
    reals: Mapping[str, str]
    types: Mapping[str, str]
    counts: Mapping[str, int] = field(default_factory=dict)

    def type(self, kind: str) -> str:
        return self.syntax.types[self.real if kind == "real" else kind]


class _Function:
    def __init__(self, words: _Words, tree: ast.FunctionDef) -> None:
        self.words, self.syntax, self.tree = words, words.syntax, tree
        self.kinds = {each.arg: _kind_of(each) for each in tree.args.args}
        self.parameters = set(self.kinds)
        self.used: list[Uses] = []
        stores = [n.id for n in ast.walk(tree) if isinstance(n, ast.Name) and isinstance(n.ctx, ast.Store)]
        self.once = {name for name in stores if stores.count(name) == 1}

    def text(self, declared: Code = NO_CODE) -> Code:
        syntax, tree = self.syntax, self.tree
        docstring = ast.get_docstring(tree) or ""
        inner = chosen(syntax, self.words.real, tree.name, declared + self._block(tree.body))
        names = {**self.words.types, **self.words.reals}
        comment = [] if not docstring or docstring.endswith(".") else [syntax.comment(docstring.format(**names))]
        before, after = syntax.around.get(tree.name, ((), ()))
        head = {
            "type": self._type(_NUMBERS[_annotation(tree.returns)]),
            "name": f"{self.words.prefix}_{tree.name}",
            "parameters": ", ".join(map(self._parameter, tree.args.args)) or syntax.empty,
        }
        types = frozenset(self.words.types.values()) if "int" in _names(tree) else frozenset()
        start = code(*before, *comment, *(line.format(**head) for line in syntax.function))
        uses = united([*self.used, Uses(types=types)])
        return start + inner + code("}", *after) + Code((), uses)

    def _type(self, kind: str) -> str:
        self.used += [TRUTH] if kind == "bool" else []
        return self.words.type(kind)

    def _count(self, value: int) -> str:
        self.used.append(Uses(widest=value))
        return self.syntax.literal(value, "unsigned")

    def _parameter(self, each: ast.arg) -> str:
        kind, real = _array(each), self.words.type("real")
        if not kind:
            return self.syntax.parameter.format(type=self.words.type(_kind_of(each)), name=each.arg)
        columns = _annotation(each.annotation) in ("Columns", "FixedColumns")
        element = self.syntax.struct(self.words.prefix, "column") if columns else real
        size = self._count(self.words.counts[kind[0]])
        return self.syntax.array_parameter[kind[1]].format(type=element, name=each.arg, size=size)

    # --- statements

    def _block(self, body: list[ast.stmt]) -> Code:
        before = dict(self.kinds)
        text = joined(self._statement(statement) for statement in body)
        self.kinds = before
        return text

    def _statement(self, node: ast.stmt) -> Code:
        match node:
            case ast.Expr(value=ast.Constant()):
                return Code()
            case ast.Expr(value=value):
                return code(f"{self._value(value)};")
            case ast.Assign(targets=[ast.Name(id=name)], value=value) if name not in self.kinds:
                return code(self._declared(name, value))
            case ast.Assign(targets=[target], value=value):
                return code(f"{self._value(target)} = {self._value(value)};")
            case ast.AugAssign(target=target):
                return code(self.syntax.increment.format(self._value(target)))
            case ast.For():
                return self._for(node)
            case ast.While(test=test, body=body):
                return braced(self.syntax.repeated.format(self._value(test)), self._block(body))
            case ast.If(test=test, body=body, orelse=[]):
                return braced(self.syntax.condition.format(self._value(test)), self._block(body))
            case ast.Return(value=ast.expr() as value):
                return code(self.syntax.result.format(self._value(value)))
        raise NotImplementedError(ast.unparse(node))

    def _declared(self, name: str, value: ast.expr) -> str:
        if isinstance(value, ast.Call) and _annotation(value.func) == "array":
            self.kinds[name], zero = "array", self.syntax.literal(0.0, self.words.real)
            size = self._value(value.args[0])
            return self.syntax.array.format(type=self.words.type("real"), name=name, size=size, value=zero)
        text, kind = self._value(value), self._kind(value)
        self.kinds[name] = kind
        template = self.syntax.constant if name in self.once else self.syntax.variable
        return template.format(type=self._type(kind), name=name, value=text)

    def _for(self, loop: ast.For) -> Code:
        assert isinstance(loop.iter, ast.Call)
        k, bounds, body, also = _annotation(loop.target), loop.iter.args, loop.body, ""
        match body[0]:
            case ast.If(test=ast.UnaryOp(op=ast.Not(), operand=test), body=[ast.Break()]):
                also, body = self._value(test), body[1:]
        first = self._value(bounds[0]) if len(bounds) > 1 else self._count(0)
        end = self._value(bounds[1] if len(bounds) > 1 else bounds[0])
        head: list[str] = [self.syntax.falling.format(k=k, first=first, end=end)]
        if len(bounds) < 3:
            used = any(k in _names(statement) for statement in body)
            head = list(self.syntax.loop(k, first, end, also, used))
        self.kinds[k] = "index"
        inner = code(*head[1:]) + self._block(body)
        del self.kinds[k]
        return braced(head[0], inner)

    # --- expressions

    def _kind(self, node: ast.expr) -> str:
        match node:
            case ast.Constant(value=bool()) | ast.Compare() | ast.BoolOp():
                return "bool"
            case ast.Constant(value=int()):
                return "index"
            case ast.Name(id=name):
                return "index" if name in self.words.counts else self.kinds.get(name, "real")
            case ast.BinOp(left=part) | ast.IfExp(body=part) | ast.UnaryOp(operand=part):
                return self._kind(part)
        return "real"

    def _value(self, node: ast.expr, level: float = 0) -> str:
        text, binds = self._raw(node)
        return f"({text})" if binds < level else text

    def _raw(self, node: ast.expr) -> Text:
        match node:
            case ast.Constant(value=bool() as truth):
                self.used.append(TRUTH)
                return ("true" if truth else "false"), ATOM
            case ast.Constant(value=int() as count):
                return self._count(count), ATOM
            case ast.Constant(value=float() as number):
                return self.syntax.literal(number, self.words.real), ATOM
            case ast.Name(id=name) if name in self.words.counts:
                return self._count(self.words.counts[name]), ATOM
            case ast.Name(id=name):
                return self.words.reals.get(name, name), ATOM
            case ast.BinOp(left=left, op=sign, right=right) | ast.Compare(left=left, ops=[sign], comparators=[right]):
                return self._infix(self._kind(node), left, sign, right)
            case ast.BoolOp(op=ast.And(), values=values):
                return self.syntax.both.join(self._value(each, AND + 0.1) for each in values), AND
            case ast.BoolOp(op=ast.Or(), values=values):
                return self.syntax.either.join(self._value(each, OR + 0.1) for each in values), OR
            case ast.UnaryOp(op=ast.Not(), operand=operand):
                return self.syntax.opposite.format(self._value(operand, ATOM)), UNARY
            case ast.UnaryOp(op=ast.USub(), operand=operand):
                return f"-{self._value(operand, ATOM)}", UNARY
            case ast.IfExp(test=test, body=yes, orelse=no):
                tested, chosen = self.syntax.chosen
                branches = {"yes": self._value(yes, chosen), "no": self._value(no, chosen)}
                return self.syntax.choice.format(test=self._value(test, tested), **branches), SELECT
            case ast.Subscript(value=value, slice=index):
                return f"{self._value(value)}[{self._value(index)}]", ATOM
            case ast.Attribute(value=value, attr=name):
                return f"{self._value(value)}.{name}", ATOM
            case ast.Call(func=ast.Name(id=name), args=arguments):
                return self._call(name, arguments)
        raise NotImplementedError(ast.unparse(node))

    def _infix(self, kind: str, left: ast.expr, sign: ast.operator | ast.cmpop, right: ast.expr) -> Text:
        """Return the text of left sign right; sums and products group
        to the left, operands of a comparison are no comparisons."""
        infix, binds = _INFIX[type(sign)]
        least = binds + 0.1 * isinstance(sign, ast.cmpop)
        text = f"{self._value(left, least)}{infix}{self._value(right, binds + 0.1)}"
        if self.words.real in self.syntax.rounded and kind == "real":
            return self.syntax.rounded[self.words.real].format(text), ATOM
        return text, binds

    def _call(self, name: str, arguments: list[ast.expr]) -> Text:
        kinds = {"real": self.words.type("real"), **self.words.types}
        if name == "aligned":
            text, level = self.syntax.aligned
            return text.format(self._value(arguments[0], level), upper=self.words.prefix.upper()), level
        if name in kinds:
            value = self._value(arguments[0], UNARY)
            return self.syntax.cast.format(type=kinds[name], value=value), self.syntax.casted
        texts = list[str]()
        for node, parameter in zip(arguments, self.words.functions[name].args.args, strict=True):
            text, kind = self._value(node), _array(parameter)
            # a parameter that is an array is passed on as it is
            texts.append(self.syntax.passed[kind[1]].format(text) if kind and text not in self.parameters else text)
        return f"{self.words.prefix}_{name}({', '.join(texts)})", ATOM


def _names(node: ast.AST) -> set[str]:
    return {each.id for each in ast.walk(node) if isinstance(each, ast.Name)}


_MEANINGS = {POWER_OF_TWO: "2^x for whole x, where that is a normal number"}


def needed(names: Collection[str], real: Real) -> list[str]:
    """Return those of the `names` that are elementary functions (sin, exp ..), in the order of `elementary`."""
    return [name for name in elementary(real) if name in names]


def functions(syntax: Syntax, prefix: str, real: Real, used: Collection[str]) -> Code:
    """Return the text of the helper and elementary functions in `used`, each function after those that it calls."""
    text = bundled(syntax, prefix, real, needed(used, real))
    below = small_functions(syntax, prefix, real, called_by({*used, *text.uses.helpers}))
    return below + text + code("") if text.lines else below


def bundled(syntax: Syntax, prefix: str, real: Real, names: Collection[str]) -> Code:
    """Return the text of elementary functions (sin, exp ..) in the language of `syntax`, after the function 2^k where
    one of them calls it."""
    texts = [_bundled(syntax, prefix, real, name) for name in names]
    if any(POWER_OF_TWO in text.uses.helpers for text in texts):
        texts.insert(0, _bundled(syntax, prefix, real, POWER_OF_TWO))
    return spaced(texts) if texts else Code()


def argument_names(name: str) -> tuple[str, ...]:
    """Return the names of the arguments of an elementary function: (x, y) for atan2, (x,) for sin."""
    return ("x", "y")[: _graph(name, "double").n_in()]


def _head(syntax: Syntax, prefix: str, real: Real, name: str) -> list[str]:
    parameters = ", ".join(syntax.parameter.format(type=syntax.types[real], name=each) for each in argument_names(name))
    words = {"type": syntax.types[real], "name": f"{prefix}_{name}", "parameters": parameters}
    return [line.format(**words) for line in syntax.function]


def _graph(name: str, real: Real) -> ca.Function:
    return ARITHMETIC[real].power_of_two if name == POWER_OF_TWO else elementary(real)[name]


def _bundled(syntax: Syntax, prefix: str, real: Real, name: str) -> Code:
    names = argument_names(name)
    printer = Printer(
        syntax,
        real=real,
        prefix=prefix,
        inputs=lambda argument, _: Operand(names[argument]),
        local=lambda argument, _: names[argument],
        calls=CALLS | {ca.OP_FLOOR: "whole"},  # their arguments are small
        reserved=set(names),
    )
    constants, result = printer.body(_graph(name, real), [Target(syntax.result.format)])
    inner = chosen(syntax, real, name, constants + result)
    heading = [syntax.comment(_MEANINGS[name])] if name in _MEANINGS else []
    return joined([code(*heading, *_head(syntax, prefix, real, name)), inner, code("}")])


# the functions of CMSIS-DSP in single precision; others come from the C library there
_CMSIS = {"sin": "arm_sin_f32", "cos": "arm_cos_f32"}
_FULL_RANGE = {f"{part}_{name}": name for part in ("small", "bounded") for name in ("sin", "cos")}


def includes(prefix: str, real: Real, used: Collection[str]) -> list[str]:
    """Return the C lines that include the header of the selected mathematical library, none if `used` has no elementary
    function."""
    if not needed(used, real):
        return []
    upper = prefix.upper()
    cmsis = [f"#elif defined({upper}_USE_CMSIS)", '#include "arm_math.h"', "#include <math.h>"]
    return [f"#if defined({upper}_USE_LIBM)", "#include <math.h>", *(cmsis if real == "float" else []), "#endif"]


def c_functions(syntax: Syntax, prefix: str, real: Real, used: Collection[str]) -> Code:
    """Return the C functions in `used`: helpers, then elementary functions behind the preprocessor switch that selects
    a library."""
    names, outside = needed(used, real), small_functions(syntax, prefix, real, called_by(used))
    if not names:
        return outside
    texts = bundled(syntax, prefix, real, names)
    below = called_by(texts.uses.helpers) - called_by(used)
    inside = small_functions(syntax, prefix, real, below)
    upper, suffix = prefix.upper(), "f" if real == "float" else ""
    cmsis = f", or {upper}_USE_CMSIS for CMSIS-DSP" if real == "float" else ""
    switch = [
        "/* Mathematical functions, bundled by default: no library, the same bits where FLT_EVAL_METHOD is 0.",
        f" * Define {upper}_USE_LIBM for those of <math.h>{cmsis}. */",
    ]
    libraries = {"LIBM": dict[str, str](), **({"CMSIS": _CMSIS} if real == "float" else {})}
    for test, (library, library_names) in zip(("#if", "#elif"), libraries.items(), strict=False):
        switch.append(f"{test} defined({upper}_USE_{library})")
        for name in names:
            full_name = _FULL_RANGE.get(name, name)
            call = f"{library_names.get(full_name, f'{full_name}{suffix}')}({', '.join(argument_names(name))})"
            switch += [*_head(syntax, prefix, real, name), f"    return {call};", "}", ""]
    return joined([outside, code(*switch, "#else"), inside, texts, code("#endif", "")])
