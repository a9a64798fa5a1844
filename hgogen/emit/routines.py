"""The functions of routines in emitted code, such as the plant's flow."""

from collections.abc import Collection, Iterator
from dataclasses import dataclass

from hgogen.discretisation.runge_kutta import MEANINGS
from hgogen.emit.code import Code, code, joined
from hgogen.emit.printer import Operand, Printer
from hgogen.emit.rolled import Target
from hgogen.emit.statements import Writer
from hgogen.emit.subprograms import Subprogram


def routines(writer: Writer, keys: Collection[str]) -> Code:
    """The functions of a step's routines with these keys, one after the other."""
    chosen = (subprogram for key, subprogram in writer.subprograms.items() if key in keys)
    return joined(_Function(writer, subprogram).text() for subprogram in chosen)


@dataclass(frozen=True, eq=False)
class _Function:
    """Prints one: it reads columns and parameters, and writes its results."""

    writer: Writer
    subprogram: Subprogram

    def text(self) -> Code:
        """Its comment, its head and its statements."""
        syntax, routine = self.writer.syntax, self.subprogram.routine
        head = {"type": syntax.types["void"], "name": f"{self.writer.prefix}_{self.subprogram.name}"}
        parameters = ", ".join(self._parameters())
        lines = (line.format(**head, parameters=parameters) for line in syntax.function)
        names = (name for each in self.subprogram.passed for name in each.names)
        printer = Printer(
            syntax,
            real=self.writer.real,
            prefix=self.writer.prefix,
            inputs=self._read,
            local=lambda argument, element: routine.arguments[argument].local(element),
            indexed=self._indexed,
            least=self.writer.least,
            taken={"p", *(name for name, _ in routine.results), *names},
        )
        places = [(name, k) for name, size in routine.results for k in range(size)]
        entries = [entry for k in range(len(routine.results)) for entry in routine.entries(k)]
        targets = [self._written(*place, entry) for place, entry in zip(places, entries, strict=True)]
        arrays = [each.number for each in self.subprogram.passed if not each.by_value]
        constants, statements = printer.body(routine.function, targets, hoist=arrays)
        said = code(syntax.comment(MEANINGS[routine.name]), *lines)
        return said + (constants + statements).indented() + code("}", "")

    def _written(self, name: str, k: int, entry: str) -> Target:
        """The place of an element; of a matrix a comment says which it is."""
        said = f" {self.writer.syntax.comment(entry)}" if entry else ""
        return Target(
            lambda text: f"{name}[{k}] = {text};{said}",
            array=name,
            element=k,
            each=lambda number, text: f"{name}[{number}] = {text};",
        )

    def _indexed(self, number: int) -> str:
        argument = self.subprogram.routine.arguments[number]
        for each in self.subprogram.passed:
            if each.number == number:
                return "" if each.by_value else argument.label
        assert argument.place
        return self.writer.indexed(argument.place, argument.size)

    def _read(self, number: int, element: int) -> Operand:
        argument = self.subprogram.routine.arguments[number]
        for each in self.subprogram.passed:
            if each.number == number:
                text = argument.local(element) if each.by_value else f"{argument.label}[{element}]"
                return Operand(text, local=each.by_value)
        assert argument.place
        text, uses = self.writer.lvalue(argument.place, element, argument.size), self.writer.uses(argument.place)
        return Operand(text, local=False, uses=uses)

    def _parameters(self) -> Iterator[str]:
        syntax, real = self.writer.syntax, self.writer.syntax.types[self.writer.real]
        if self.subprogram.reads_parameters:
            yield syntax.params.format(prefix=self.writer.prefix)
        for each in self.subprogram.passed:
            how = syntax.parameter if each.by_value else syntax.array_parameter[False]
            yield from (how.format(type=real, name=name, size=each.argument.size) for name in each.names)
        for name, size in self.subprogram.routine.results:
            yield syntax.array_parameter[True].format(type=real, name=name, size=size)
