"""Statements of a step that occur several times, or make a function too long, as functions of the emitted file.

A part is a block with a name for it, with the statements after it up to the next such block, as far as they touch only
the state and the status. A part becomes a function if it occurs more than once and writes so many numbers that a call
is shorter.

A section with more than `MAX_PATHS` paths has functions for its named blocks and the named bodies of its conditions.
Their arguments are the work values that they share with the section, by pointer where they change them.
"""

# Takes apart: names of parts.

from collections import Counter
from collections.abc import Callable, Collection, Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import cache, cached_property
from itertools import chain, count

import numpy as np

from hgogen.discretisation import kernels
from hgogen.emit import helpers
from hgogen.emit.code import MAX_PATHS, Code, code, joined, paths, variables
from hgogen.emit.elementary import POWER_OF_TWO, elementary
from hgogen.emit.interface import AT, Parameter, Prototype, entries, same_name, status_type, structs
from hgogen.emit.portable import functions_of
from hgogen.emit.statements import Writer
from hgogen.program import Block, Call, Loop, Place, Program, Section, Sized, Statement, When, blocks, places, walk
from hgogen.stepping.machine import Interpreter

_OTHERS = {"ready", "nominal", "checksum", "save", "restore"}  # functions of the file besides its interface
FEWEST = 4  # numbers that a repeated part writes
SMALLEST = 3  # paths of a named block that becomes a function
_MEANINGS = {  # the head comment of a function, by the name of its part
    "guard_input": "replace an input that is not finite or absurd by the last valid one, and clamp it to its range",
    "guard_measurement": "is the sample a number, plausible, and not absurdly far from its estimate?",
    "guard_measurements": "is each sample a number, plausible, and not absurdly far from its estimate?",
    "suspect": "is the estimate out of a range or far from a sample, or does a fault count run?",
    "sample_in_plausible_range": "is there a sample in the plausible range of its sensor? It judges the estimate, even "
    "where it is too far off to correct it",
    "counts_spoiled": "is a fault count or limit out of its range, or does the checksum differ?",
    "find_signs": "the change of the fault count of an output at this sample, and the sign of its error",
    "beyond_box": "is a number of the state beyond its limits, or not a number?",
    "value_lost": "is a number of the state not finite, or beyond 1e30?",
    "choose_recovery": "which fault counts are at their limits, and must the estimate restart?",
    "clear_fault_counts": "set the fault counts and their limits as after a reset",
    "clear_rest": "set what the observer remembers besides the estimate as after a reset",
    "advance": "advance the estimate from the last call to now",
    "use_sample": "correct the estimate with a sample that can be used",
    "adapt_gain": "adapt the gain",
    "count_faults": "count the signs of a fault at a sample, and act where a count is at its limit",
    "recover": "a fault count is at its limit: restart from the sample, or project onto the ranges",
    "restart_from_sample": "take the nearest estimate that fits the sample, and set all else as after a reset",
}


@dataclass(frozen=True, eq=False)
class Passage(Call):
    """The C call of a function that computes a part of a section (predict, correct ..), as `prototype` declares it.

    Args: `parameters` the parameters of the section that the call passes on; `work` the work variables that it shares
    with the function, passed by pointer if `changed`, or returned if it is the only `result`; `returns_status` whether
    the function returns a status.
    """

    prototype: Prototype
    parameters: tuple[str, ...]
    work: Sized
    changed: frozenset[Place]
    result: Place | None
    returns_status: bool

    @property
    def reads(self) -> Sized:
        """The work variables that the call passes, with their sizes."""
        return self.work

    @property
    def written(self) -> Sized:
        """The work variables that the call changes, with their sizes."""
        return tuple((place, size) for place, size in self.work if place in self.changed)


@dataclass(frozen=True, eq=False)
class Part:
    """Statements that become a C function of their own: its declaration, its program, and the text of its body."""

    prototype: Prototype
    program: Program
    body: Code

    @property
    def call(self) -> Code:
        """The C statement that calls the function."""
        call = self.prototype.call(same_name)
        text = f"{call};" if self.prototype.returns == "void" else f"status |= {call};"
        return code(text, parameters=("s",))


@dataclass(frozen=True, eq=False)
class SharingWriter(Writer):
    """A writer of a step's C in which statements that several sections repeat, and parts of a long section, become
    functions.

    Args: `passed` the work variables that are parameters of the current function, and `pointed` those that are
    pointers; `main` the writer of the section that calls this function; `functions` the functions of parts, and `named`
    their names by signature and body.
    """

    passed: frozenset[Place] = frozenset()
    pointed: frozenset[Place] = frozenset()
    main: "SharingWriter | None" = None
    named: dict[tuple[str, Code], str] = field(default_factory=dict)
    functions: dict[str, Code] = field(default_factory=dict)

    def program(self, program: Iterable[Statement], *known: frozenset[str]) -> Code:
        """Return the C of the statements in order, with a function call in place of each repeated part."""
        texts = list[Code]()
        for run in _runs(program):
            part = self._parts.get(self._alone(run).lines) if _name(run) else None
            texts.append(part.call if part else super().program(run, *known))
        return joined(texts)

    @cached_property
    def parts(self) -> tuple[Part, ...]:
        """The groups of statements that occur more than once, as C functions."""
        return tuple(self._parts.values())

    @cached_property
    def resetting(self) -> dict[Place, Part]:
        """The places of the state that a shared function sets to their initial values, each with that function."""
        return {place: part for part in self.parts for place in self._reset_places(part.program)}

    def section(self, section: Section) -> tuple[list[Code], Code]:
        """Return the C functions that a section is divided into, in the order of their calls, and the section's
        body."""
        known = len(self.functions)
        times = Counter(each.part for each in walk(section.program) if isinstance(each, Block) and not _name((each,)))
        repeated = {part for part, count in times.items() if part and count > 1}
        section = replace(section, program=self._once(section.program, section, repeated))
        body = self.function(self._split(section.program, section))
        return list(self.functions.values())[known:], body

    def _once(self, program: Program, section: Section, repeated: Collection[str]) -> Program:
        """Return the program with a call of one function in place of each block whose `part` is in `repeated`."""
        statements = list[Statement]()
        for each in program:
            match each:
                case When(body=body, otherwise=otherwise):
                    inner, other = (self._once(branch, section, repeated) for branch in (body, otherwise))
                    statements.append(replace(each, body=inner, otherwise=other))
                case Block(part=part) if part in repeated:
                    statements.append(self._outlined(part, (each,), section))
                case _:
                    statements.append(each)
        return tuple(statements)

    def _split(self, program: Program, section: Section) -> Program:
        if paths(self.function(program).lines) <= MAX_PATHS:
            return program
        return tuple(self._passing(statement, section) for statement in program)

    def _passing(self, statement: Statement, section: Section) -> Statement:
        match statement:
            case When(part=part, body=body) if part and not isinstance(body[0], Call):
                inner: Program = (self._outlined(part, body, section),)
            case When(body=body):
                inner = tuple(self._passing(each, section) for each in body)
            case Block(part=part) if part and not _name((statement,)):
                small = paths(self.function((statement,)).lines) < SMALLEST
                return statement if small else self._outlined(part, (statement,), section)
            case _:
                return statement
        otherwise = tuple(self._passing(each, section) for each in statement.otherwise)
        return replace(statement, body=inner, otherwise=otherwise)

    def _outlined(self, part: str, body: Program, section: Section) -> Passage:
        statements = list(walk(body))
        work = self._shared(statements, section)
        written = {place for each in statements for place, _ in each.written}
        calls = any(isinstance(each, Call) for each in statements)
        changed = frozenset(place for place, _ in work if place in written)
        returns_status = calls or any(place.struct == "status" for place in written)
        result = self._result(body, work, changed) if not returns_status else None
        arguments = tuple((place, size) for place, size in work if place != result)
        text = self._body(body, section, arguments, changed)
        used = variables(text.lines)  # a method may need fewer values than its blocks read
        arguments = tuple((place, size) for place, size in arguments if place.name in used)
        writes_state = calls or any(p.struct == "state" or p.struct in self.kinds.groups for p in written)
        structs_used = self._structs(text.uses.parameters, writes_state)
        parameters = (*structs_used, *(self._parameter(*each, changed) for each in arguments))
        returns = status_type(self.step) if returns_status else self._type(result, 1) if result else "void"
        meaning = _meaning(part)
        heading = [self.syntax.comment(meaning)] if meaning else []
        text = code(*[f"{returns} status = 0u;"] * returns_status) + text
        text += code(*["return status;"] * returns_status, *[f"return {result.name};"] if result else [])
        name = self._new_name(part, section, (f"{returns} ({', '.join(map(str, parameters))})", text))
        prototype = Prototype(returns, f"{self.prefix}_{name}", parameters, public=False)
        self.functions[name] = code(*heading, str(prototype), "{") + text.indented() + code("}")
        work = tuple((place, size) for place, size in work if place == result or (place, size) in arguments)
        passed = tuple(each.name for each in structs_used)
        return Passage(Section(name, "", body), prototype, passed, work, changed, result, returns_status)

    def _shared(self, statements: Sequence[Statement], section: Section) -> Sized:
        inside = {id(each) for each in statements}
        around = {p for s in walk(section.program) if id(s) not in inside for p, _ in (*s.reads, *s.written)}
        known = {each for s in statements for each in (*s.reads, *s.written)}
        return tuple(sorted((p, n) for p, n in known if p.struct == "work" and p in around))

    def _body(self, body: Program, section: Section, arguments: Sized, changed: frozenset[Place]) -> Code:
        pointed = frozenset(place for place, size in arguments if size == 1 and place in changed)
        inner = replace(self, passed=frozenset(dict(arguments)), pointed=pointed, main=self.main or self)
        program = inner._split(body, section) if len(body) > 1 else body
        text = inner.function(program)
        return replace(inner, interval_calls=True).function(program) if paths(text.lines) > MAX_PATHS else text

    def _structs(self, used: Collection[str], writes_state: bool) -> list[Parameter]:
        kinds = [replace(each, constant=each.name != "s" or not writes_state) for each in structs(self.step)]
        return [each for each in (*kinds, AT) if each.name in used]

    def _parameter(self, place: Place, size: int, changed: frozenset[Place]) -> Parameter:
        pointer = size > 1 or place in changed
        return Parameter(self._type(place, size), place.name, pointer and place not in changed, pointer)

    def _new_name(self, part: str, section: Section, function: tuple[str, Code]) -> str:
        corrects = section.corrects and not part.endswith(f"_{section.corrects}")
        by_section = f"{part}_{section.name}"
        usual = f"{part}_{section.corrects}" if corrects else part, by_section
        present = {*self.named.values(), *self._function_names, *(_name(each.program) for each in self.parts)}
        names = chain(usual, (f"{by_section}_{k}" for k in count(2)))
        return self.named.setdefault(function, next(name for name in names if name not in present))

    def _result(self, body: Program, work: Sized, changed: frozenset[Place]) -> Place | None:
        if len(body) > 1 or len(changed) != 1 or not isinstance(body[0], Block):
            return None
        read = dict(body[0].reads)
        return next((place for place, size in work if place in changed and size == 1 and place not in read), None)

    def _type(self, place: Place, size: int) -> str:
        return self.syntax.types[self.kind(place, size)]

    def _passage(self, passage: Passage, reserved: frozenset[str]) -> Code:
        work = [(place, size) for place, size in passage.work if place != passage.result]
        arguments = [*passage.parameters, *(self._argument(*each, passage.changed) for each in work)]
        call = f"{passage.prototype.name}({', '.join(arguments)})"
        if passage.result:
            call = self._assigned(passage.result, self.place_text(passage.result), call).rstrip(";")
        return code(f"{'status |= ' * passage.returns_status}{call};", parameters=passage.parameters)

    def _argument(self, place: Place, size: int, changed: frozenset[Place]) -> str:
        if size > 1 or place not in changed:
            return self.place_text(place) if size == 1 else place.name
        return place.name if place in self.pointed else f"&{place.name}"

    def place_text(self, place: Place) -> str:
        """Return the C text of a place of memory, dereferenced (*name) where a parameter points to it."""
        return f"(*{place.name})" if place in self.pointed else super().place_text(place)

    def _assigned(self, place: Place, target: str, text: str) -> str:
        return super()._assigned(place, f"*{place.name}" if place in self.pointed else target, text)

    def _declaration(self, place: Place, size: int) -> Code:
        return Code() if place in self.passed else super()._declaration(place, size)

    @cached_property
    def _parts(self) -> dict[tuple[str, ...], Part]:
        if self.main:
            return self.main._parts
        runs = [run for section in self.step.code.called for run in _everywhere(section.program) if _name(run)]
        texts = [self._alone(run) for run in runs]
        times, names, parts = Counter(text.lines for text in texts), Counter[str](), dict[tuple[str, ...], Part]()
        for run, text in zip(runs, texts, strict=True):
            if times[text.lines] > 1 and text.lines not in parts and _numbers(run) >= FEWEST:
                names[_name(run)] += 1
                parts[text.lines] = Part(self._prototype(run, names[_name(run)]), run, text)
        return parts

    def _prototype(self, run: Program, number: int) -> Prototype:
        returns = status_type(self.step) if any(place.struct == "status" for place in _written(run)) else "void"
        number += _name(run) in self._function_names
        name = f"{self.prefix}_{_name(run)}" + (f"_{number}" if number > 1 else "")
        return Prototype(returns, name, structs(self.step)[:1], _meaning(_name(run)), False)

    @cached_property
    def _function_names(self) -> set[str]:
        functions = {*functions_of(kernels), *functions_of(helpers), *elementary(self.real), POWER_OF_TWO}
        functions |= {subprogram.name for subprogram in self.subprograms.values()} | _OTHERS
        return functions.union(*((entry.name, entry.inner) for entry in entries(self.step).values()))

    @cached_property
    def _alone(self) -> Callable[[Program], Code]:
        return cache(Writer(self.syntax, self.step, self.real).function)

    def _reset_places(self, run: Program) -> set[Place]:
        structs_ = {"state", *self.kinds.groups}
        initial = {place: field.initial for place, field in self.kinds.fields.items() if place.struct in structs_}
        written = _written(run)
        if not written <= initial.keys():
            return set()
        memory = (reading := Interpreter(run, self.step.layout.groups)).memory
        for place in memory.keys() & initial.keys():
            memory[place][...] = np.nan if place in written else initial[place]
        reading.action(run)()
        return written if all((memory[place] == initial[place]).all() for place in written) else set()


def _meaning(part: str) -> str:
    fitted = f"move the estimate to the nearest one that fits the sample of {part.removeprefix('fit_')}"
    return fitted if part.startswith("fit_") else _MEANINGS.get(part, "")


def _everywhere(program: Program) -> Iterator[Program]:
    bodies = (body for statement in walk(program) for body in statement.bodies.values())
    return (run for each in (program, *bodies) for run in _runs(each))


def _runs(program: Iterable[Statement]) -> Iterator[Program]:
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
    inner = list(walk((statement,)))
    known = {"state", "status", *(each.group for each in inner if isinstance(each, Loop))}
    return all(isinstance(each, Block | Loop) for each in inner) and {p.struct for p, _ in places(inner)} <= known


def _written(run: Program) -> set[Place]:
    return {place for block in blocks(run) for place in block.writes}


def _numbers(run: Program) -> int:
    return sum(size for block in blocks(run) for place, size in block.written if place.struct != "status")
