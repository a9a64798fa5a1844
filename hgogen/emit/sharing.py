"""Statements of a step that stand in several places, as functions of the emitted file.

A part is a block that has a name for it, and the statements behind it up to the next such block, as far as they touch
nothing but the state and the status. One that stands more than once, and writes so many numbers that a call is
shorter, is a function.
"""

from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from functools import cache, cached_property

import numpy as np

from hgogen.emit.code import Code, code, joined
from hgogen.emit.interface import Prototype, own, status_type, structs
from hgogen.emit.statements import Writer
from hgogen.program import Block, Loop, Place, Program, Statement, blocks, lines_of, places, walk
from hgogen.stepping.machine import Reading

FEWEST = 4  # numbers that a part writes


@dataclass(frozen=True, eq=False)
class Part:
    """A part as a function: how it is declared, its program and the text of that."""

    prototype: Prototype
    program: Program
    body: Code

    @property
    def call(self) -> Code:
        """The statement in its place."""
        call = self.prototype.call(own)
        text = f"{call};" if self.prototype.returns == "void" else f"status |= {call};"
        return code(text, parameters=("s",))


@dataclass(frozen=True, eq=False)
class SharingWriter(Writer):
    """Writes a part that stands more than once as a call."""

    def program(self, program: Iterable[Statement], *known: frozenset[str]) -> Code:
        """Every statement in order."""
        texts = list[Code]()
        for run in _runs(program):
            part = self._parts.get(self._alone(run).lines) if _name(run) else None
            texts.append(part.call if part else super().program(run, *known))
        return joined(texts)

    @cached_property
    def parts(self) -> tuple[Part, ...]:
        """Those that stand more than once."""
        return tuple(self._parts.values())

    @cached_property
    def fresh(self) -> dict[Place, Part]:
        """The places of the state that some of them leave as after a reset, where they begin from one."""
        return {place: part for part in self.parts for place in self._left(part.program)}

    @cached_property
    def _parts(self) -> dict[tuple[str, ...], Part]:
        runs = [run for section in self.step.code.called for run in _everywhere(section.program) if _name(run)]
        texts = [self._alone(run) for run in runs]
        times, names, parts = Counter(text.lines for text in texts), Counter[str](), dict[tuple[str, ...], Part]()
        for run, text in zip(runs, texts, strict=True):
            if times[text.lines] > 1 and text.lines not in parts and _numbers(run) >= FEWEST:
                names[_name(run)] += 1
                parts[text.lines] = Part(self._prototype(run, names[_name(run)]), run, text)
        return parts

    def _prototype(self, run: Program, number: int) -> Prototype:
        says = any(place.struct == "status" for place in _written(run))
        name = f"{self.prefix}_{_name(run)}" + (f"_{number}" if number > 1 else "")
        return Prototype(status_type(self.step) if says else "void", name, structs(self.step)[:1], public=False)

    @cached_property
    def _alone(self) -> Callable[[Program], Code]:
        """The statements of a part as a function has them, once, as each is asked for wherever it stands."""
        return cache(Writer(self.syntax, self.step, self.real).function)

    def _left(self, run: Program) -> set[Place]:
        """The places that a part writes, if all of them are as after a reset then; else none."""
        structs_ = [("state", self.step.layout.state)]
        structs_ += [(line[-1].name, line[-1].fields) for line in lines_of(self.step.layout.groups)]
        initial = {Place(struct, field.name): field.initial for struct, fields in structs_ for field in fields}
        written = _written(run)
        if not written <= initial.keys():
            return set()
        memory = (reading := Reading(run, self.step.layout.groups)).memory
        for place in memory.keys() & initial.keys():
            memory[place][...] = np.nan if place in written else initial[place]
        reading.action(run)()
        return written if all((memory[place] == initial[place]).all() for place in written) else set()


def _everywhere(program: Program) -> Iterator[Program]:
    """The parts, and what is between them, of a program and of every program in it."""
    yield from _runs(program)
    for body in (body for statement in program for body in statement.bodies.values()):
        yield from _everywhere(body)


def _runs(program: Iterable[Statement]) -> Iterator[Program]:
    """The parts of a program, and each other statement by itself."""
    run: Program = ()
    for statement in program:
        alone = not _closed(statement)
        if run and (alone or not _name(run) or _name((statement,))):
            yield run
            run = ()
        run = (*run, statement)
    if run:
        yield run


def _name(run: Program) -> str:
    first = run[0]
    return first.part if isinstance(first, Block) and _closed(first) else ""


def _closed(statement: Statement) -> bool:
    """Whether a statement touches nothing but the state and the status."""
    inner = list(walk((statement,)))
    known = {"state", "status", *(each.group for each in inner if isinstance(each, Loop))}
    return all(isinstance(each, Block | Loop) for each in inner) and {p.struct for p, _ in places(inner)} <= known


def _written(run: Program) -> set[Place]:
    return {place for block in blocks(run) for place in block.writes}


def _numbers(run: Program) -> int:
    return sum(size for block in blocks(run) for place, size in block.written if place.struct != "status")
