"""Interpretation of programs in Python, block by block, in double precision: of a step, or of separate statements."""

from collections.abc import Callable, Iterable, Mapping
from typing import Any

import numpy as np

from hgogen.discretisation.kernels import KERNELS
from hgogen.program import (
    Bit,
    Block,
    Call,
    Copy,
    Field,
    Group,
    Kernel,
    Loop,
    Place,
    Program,
    Reader,
    When,
    lines_of,
    places,
    walk,
)
from hgogen.step import Step

Action = Callable[[], None]
Bound = tuple[Action, list[np.ndarray]]


def casadi_block(block: Block, arguments: list[np.ndarray]) -> Bound:
    """Return a function without arguments that evaluates the block's graph on the arrays `arguments`, and the arrays
    into which it writes the results."""
    buffer: Any  # its type stubs require the size, which it reads from the memory itself
    buffer, evaluate = block.graph.buffer()
    results = [np.zeros(block.graph.numel_out(i)) for i in range(len(block.writes) + len(block.names))]
    for index, array in enumerate(arguments):
        buffer.set_arg(index, array.data)
    for index, array in enumerate(results):
        if array.size:
            buffer.set_res(index, array.data)

    def run() -> None:
        evaluate()

    run.keep = (buffer, arguments, results)  # type: ignore[attr-defined]
    return run, results[: len(block.writes)]


class Interpreter(Reader[Action]):
    """An interpreter of programs over one memory. `memory` maps each place to an array, initially 0: (size), (count,
    size) for a field of a group, (count, count, size) for a field of a group in a group. `status`: the raised bits."""

    def __init__(
        self,
        program: Program,
        groups: Iterable[Group] = (),
        bits: Iterable[Bit] = (),
        bind: Callable[[Block, list[np.ndarray]], Bound] = casadi_block,
        dtype: Any = np.float64,
    ) -> None:
        self._bind, self._dtype = bind, dtype
        self.memory: dict[Place, np.ndarray] = {}
        self.status = 0
        self._rows: dict[Place, np.ndarray] = {}  # the current member of a loop
        self._tables: dict[Place, np.ndarray] = {}  # the array of a loop: in a group, that of its member
        self._groups = {line[-1].name: line for line in lines_of(groups)}
        self._bits = {bit.place: 1 << k for k, bit in enumerate(bits)}
        self._sections: dict[str, Action] = {}
        for place, size in sorted(places(program), reverse=True):  # the largest size, of a name in several sections
            self.memory.setdefault(place, np.zeros(size, dtype))
        for name, line in self._groups.items():
            for field in line[-1].fields:
                place, shape = Place(name, field.name), (*(group.count for group in line), field.size)
                self.memory[place] = np.zeros(shape, dtype)
                self._tables[place] = self.memory[place] if len(line) == 1 else np.zeros(shape[1:], dtype)
                self._rows[place] = np.zeros(field.size, dtype)

    def set(self, values: Mapping[Place, Any]) -> None:
        """Set the values of places in the memory; places that occur in no program are skipped."""
        for place in values.keys() & self.memory.keys():
            self.memory[place][:] = np.ravel(values[place])

    def action(self, program: Program) -> Action:
        """Return the program as a Python function without arguments that runs it on the memory."""
        return self.program(program)

    def joined(self, parts: Iterable[Action]) -> Action:
        """Return the function that calls the functions `parts` in sequence."""
        actions = list(parts)

        def run() -> None:
            for action in actions:
                action()

        return run

    def _call(self, call: Call) -> Action:
        return self._sections[call.section.name]

    def _array(self, place: Place) -> np.ndarray:
        return self._rows[place] if place.struct in self._groups else self.memory[place]

    def _block(self, block: Block) -> Action:
        evaluate, results = self._bind(block, [self._array(place) for place, _ in block.reads])
        writes = [(self._array(p), r) for p, r in zip(block.writes, results, strict=True) if p.struct != "status"]
        raised = [(self._bits[p], r) for p, r in zip(block.writes, results, strict=True) if p.struct == "status"]

        def run() -> None:
            evaluate()
            for target, result in writes:
                target[:] = result
            for bit, result in raised:
                if result[0] != 0:
                    self.status |= bit

        return run

    def _loop(self, loop: Loop) -> Action:
        body = self.action(loop.body)
        touched = sorted(
            {p for p, _ in places(loop.body)}
            | {s.columns for s in walk(loop.body) if isinstance(s, Kernel) and s.columns}
        )
        pairs = [(self._tables[p], self._rows[p]) for p in touched if p.struct == loop.group]
        pairs += [(self.memory[p], self._tables[p]) for p in touched if self._inside(p, loop.group)]
        start = self._array(loop.start) if loop.start else np.zeros(1)
        active = self._array(loop.active) if loop.active else np.array([loop.count])
        index = self._array(loop.index) if loop.index else np.zeros(1)
        total = self._groups[loop.group][-1].count

        def run() -> None:
            first = int(start[0])
            for k in range(min(loop.count, int(active[0]))):
                member = index[0] = (first + k) % total
                for stored, row in pairs:
                    row[:] = stored[member]
                body()
                for stored, row in pairs:
                    stored[member] = row

        return run

    def _inside(self, place: Place, group: str) -> bool:
        return any(above.name == group for above in self._groups.get(place.struct, ())[:-1])

    def _copy(self, copy: Copy) -> Action:
        arrays = [a for p, a in self.memory.items() if p.struct == copy.group or self._inside(p, copy.group)]
        source, target = self._array(copy.source), self._array(copy.target)

        def run() -> None:
            for array in arrays:
                array[int(target[0])] = array[int(source[0])]

        return run

    def _when(self, when: When) -> Action:
        flag, body, otherwise = self._array(when.flag), self.action(when.body), self.action(when.otherwise)

        def run() -> None:
            (body if flag[0] != 0 else otherwise)()

        return run

    def _kernel(self, kernel: Kernel) -> Action:
        operation, columns = KERNELS[kernel.name], [self._tables[kernel.columns]] if kernel.columns else []
        arguments = [*columns, *(self._array(place) for place, _ in kernel.arguments), *kernel.counts]
        result = self._array(kernel.result) if kernel.result else np.zeros(1)

        def run() -> None:
            with np.errstate(all="ignore"):
                result[0] = operation(*arguments) or 0

        return run


class Machine(Interpreter):
    """An interpreter of the generated step in Python: its memory and its programs."""

    def __init__(
        self,
        step: Step,
        bind: Callable[[Block, list[np.ndarray]], Bound] = casadi_block,
        dtype: Any = np.float64,
    ) -> None:
        sections = (s for section in step.code.called for s in section.program)
        reading = (*step.code.estimate, *(s for report in step.code.reports for s in report.program))
        programs = (*sections, *reading, *step.code.tuning)
        super().__init__(programs, step.layout.groups, step.layout.bits, bind, dtype)
        self.step = step
        kinds = {
            "plant": step.layout.plant,
            "gain": step.layout.gains,
            "derived": step.layout.derived,
            "state": step.layout.state,
        }
        self.memory |= {Place(kind, f.name): np.zeros(f.size, dtype) for kind, fields in kinds.items() for f in fields}
        for kind in ("plant", "gain"):
            self._fill(kind, kinds[kind])
        self._tune = self.action(step.code.tuning)
        for section in step.code.called:
            self._sections[section.name] = self.action(section.program)
        self._estimate = self.action(reading)
        self.tune()
        self.reset()

    def tune(self) -> int:
        """Clamp the parameters to their ranges and compute the derived ones; return the status."""
        return self._run(self._tune)

    def reset(self) -> None:
        """Set the state to its values before the first call."""
        self._fill("state", self.step.layout.state)
        for name, line in self._groups.items():
            for field in line[-1].fields:
                self.memory[Place(name, field.name)][:] = np.asarray(field.initial, self._dtype)

    def section(self, name: str) -> int:
        """Run one section, such as "predict"; return its status."""
        return self._run(self._sections[name])

    def call(self) -> int:
        """Run all sections of a step, then compute the estimate; return the status."""
        status = 0
        for section in self.step.code.sections:
            status |= self._run(self._sections[section.name])
        self._run(self._estimate)
        return status

    def estimate(self) -> None:
        """Compute the estimate of the plant's state from the memory, without a step."""
        self._run(self._estimate)

    def record(self, u: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return estimates (N, n), traces (N, traces) and statuses (N) of a call for each sample u (N, m), y (N, p)."""
        step, memory = self.step, self.memory
        kinds = (("input", step.given), ("output", step.samples))
        slots = [memory[Place(kind, signal.name)] for kind, signals in kinds for signal in signals]
        results = [memory[Place("estimate", s.name)] for s in step.states]
        scalars = [(memory[each.place], each.index) for each in step.traced]
        x, traces = np.zeros((len(y), len(results))), np.zeros((len(y), len(scalars)))
        status = np.zeros(len(y), step.layout.word)
        for k in range(len(y)):
            for place, value in zip(slots, (*u[k], *y[k]), strict=True):
                place[0] = value
            status[k] = self.call()
            x[k] = [place[0] for place in results]
            traces[k] = [array[index] for array, index in scalars]
        return x, traces, status

    def _fill(self, kind: str, fields: tuple[Field, ...]) -> None:
        for field in fields:
            self.memory[Place(kind, field.name)][:] = np.asarray(field.initial, self._dtype)

    def _run(self, action: Action) -> int:
        self.status = 0
        with np.errstate(all="ignore"):  # once for all blocks: it costs as much as a short block
            action()
        return self.status
