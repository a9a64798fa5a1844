"""A library run: many models of one JSON file, each answered in a worker process.

The input is {"models": [model, ..]} as `reading.entry` reads them; the output is one object from name to
`LibraryAnswer`.

The questions about a model are a table from question to fields, cheap ones first. Each answer is proved, or generic as
its definition says, or None for no answer. Without boxes only the structure of forms is checked.

A worker is one process with one pipe. It sends ("ready", ..), receives a task, sends its results as they are found and
is ready again. A worker that exceeds its time or has died is replaced, so that a crash costs one task. The limit is
processor time, which a busy machine does not consume; a sleeping worker is ended by wall-clock time. Systems without
such timers use the wall clock alone.
"""

import dataclasses
import json
import multiprocessing
import os
import signal
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from enum import Enum
from functools import cached_property
from multiprocessing.connection import Connection, wait
from multiprocessing.process import BaseProcess
from pathlib import Path
from time import monotonic, perf_counter
from typing import Annotated, Any

import sympy as sp

from hgogen.analysis.chain import Chains, Rows, Shape, cascade, levelwise
from hgogen.analysis.singularity import gauthier_bornard, singular_set
from hgogen.check import Verdict
from hgogen.errors import HgogenError
from hgogen.reading.expression import parse
from hgogen.reading.files import Unread, content_of
from hgogen.reading.text_model import FORMAT, Entry, entry
from hgogen.rigor.bounds import Sign, bound, nonzero
from hgogen.rigor.box import sign_at
from hgogen.rigor.field import is_zero
from hgogen.rigor.rank import Model, observability
from hgogen.rigor.singular import one_sided, parts, possibly_undefined
from hgogen.rigor.slope import lipschitz_bound
from hgogen.sentence import Encoded

BYTES = 1 << 28  # largest size of a library
LIMIT = 10.0  # seconds of the processor for each model
_MANY = 30  # states, above which costly questions may take seconds
_SLOW = ("observability", "singular set")
Answer = tuple[str, Any]

Known = bool | None
Chain = list[str] | None


@dataclass(frozen=True)
class Answers(Encoded):
    """The answers about a model of a library, null where there is none."""

    observable_params_known: Annotated[Chain, "states that are observable with known parameters, generically"]
    observable_joint: Annotated[Chain, "states and unknown parameters that are observable together, generically"]
    rank_params_known: Annotated[int | None, "generic rank with known parameters"]
    rank_joint: Annotated[int | None, "generic rank of states and unknown parameters together"]
    seconds: Annotated[float | None, "seconds that these two questions took"]
    triangular: Annotated[Known, "whether z_i' = F_i(z_1..z_(i+1), u), its slopes off zero on the closed box"]
    triangular_uy: Annotated[Known, "the same, where slopes may read inputs and outputs"]
    uof_structure: Annotated[Known, "whether the plant has the structure of the uniform observability form"]
    uof: Annotated[Known, "whether it is in that form, its slopes off zero on the closed box"]
    gb_uniform: Annotated[bool | str | None, "uniform observability by Gauthier and Bornard; na: does not apply"]
    order: Annotated[Chain, "the order of states in the chain"]
    a_ranges: Annotated[list[list[float]] | None, "outward-rounded range of each |a_i|"]
    singular: Annotated[list[str] | str | None, "factors whose zeros are the singular set"]
    bounds: Annotated[list[list[float] | None] | None, "outward-rounded range of each query"]
    lipschitz: Annotated[Known, "whether b is Lipschitz on the box"]
    mimo_levelwise: Annotated[Known, "whether each output has a chain, found level by level"]
    mimo_cascade: Annotated[Known, "whether each output has a chain, one behind the other"]
    mimo_uof: Annotated[Known, "whether the plant is in the uniform observability form of several outputs"]


FIELDS = tuple(one.name for one in dataclasses.fields(Answers))


@dataclass(frozen=True)
class LibraryAnswer(Answers):
    """The answers about a model of a library, and the errors that occurred."""

    json_keys = f"{' '.join(FIELDS)} error? partial? notes?"

    error: Annotated[str | None, "what is wrong with the model"] = None
    partial: Annotated[bool | None, "true where the time limit struck"] = None
    notes: Annotated[list[str] | None, "questions that failed, and bounds of what has no value somewhere"] = None


@dataclass(eq=False)
class BadLibrary(HgogenError):
    """The error for a library (JSON file of models) that cannot be read."""

    path: str
    reason: str

    def __str__(self) -> str:
        return f'{self.path}: {self.reason}; a library is JSON, {{"models": [MODEL, ..]}}, a MODEL such as {FORMAT}'


def read(path: Path) -> list[tuple[str, Any]]:
    """Return the models of a file, each with the name of its answer.

    Raises: `BadLibrary`.
    """
    try:
        content = json.loads(content_of(path, BYTES))
    except Unread as error:
        raise BadLibrary(str(path), error.reason) from None
    except (ValueError, RecursionError) as error:
        raise BadLibrary(str(path), f"is no JSON ({error})") from None
    models = content.get("models") if isinstance(content, Mapping) else None
    if not isinstance(models, list):
        raise BadLibrary(str(path), 'has no list "models"')
    named: list[tuple[str, Any]] = []
    for k, model in enumerate(models):
        name = model.get("name") if isinstance(model, Mapping) else None
        named.append((name if isinstance(name, str) else f"models[{k}]", model))
    return named


def check(
    models: list[tuple[str, Any]], *, limit: float = LIMIT, tick: Callable[[], None] = lambda: None
) -> dict[str, dict[str, Any]]:
    """Return the answers by model name, in the models' order; `models`: pairs (name, model); `tick` is called after
    each model.

    Args: `limit`: seconds of the processor for each model; answers found until then are returned.
    """
    names = [name for name, _ in models]
    whole: dict[str, dict[str, Any]] = {name: dict.fromkeys(FIELDS) for name in names}
    tasks = []
    for name, model in models:
        if names.count(name) > 1:
            whole[name]["error"] = f"{names.count(name)} models are named {name!r}; rename all but one"
            tick()
        elif isinstance(model, Mapping) and not isinstance(model.get("name"), str):
            whole[name]["error"] = "has no name; give it one, a text"
            tick()
        else:
            tasks.append((name, model))
    for event in run(_answered, [model for _, model in tasks], limit=limit):
        answer = whole[tasks[event.task][0]]
        if event.end is None:
            field, value = event.result
            if field == "note":
                answer.setdefault("notes", []).append(value)
            else:
                answer[field] = value
            continue
        if event.end is End.LATE:
            answer["partial"] = True
        if event.end is End.CRASHED:
            answer["error"] = "the process that worked on it ended; the answers are those found before"
        tick()
    return whole


def _answered(model: Any) -> Iterator[tuple[str, Any]]:
    try:
        one = entry(model)
    except HgogenError as error:
        yield "error", str(error)
        return
    yield from answers(one)


# --- the questions -------------------------------------------------------------------------------------------


def answers(entry: Entry) -> Iterator[Answer]:
    """Yield the answers about a model as pairs (field, value) as soon as they are found; a field may be repeated with a
    more complete value.

    A text of the model that cannot be read gives ("error", sentence). A question that fails in any way gives ("note",
    sentence), and the next one is asked.
    """
    forms, many = _Forms(entry), len(entry.states) > _MANY
    # with many states, the questions that may use up the time limit are last
    for what, question in sorted(_QUESTIONS.items(), key=lambda row: many and row[0] in _SLOW):
        try:
            yield from question(forms)
        except Exception as error:  # no failure of one question may cost the others
            yield "note", f"{what}: {error or type(error).__name__}"


@dataclass(frozen=True)
class _Forms:
    """The forms of a model: its chains of integrators z_i' = a_i z_(i+1) + b_i and the signs of the gains a_i, computed
    once for all questions."""

    entry: Entry
    signs: dict[sp.Expr, bool | None] = dataclasses.field(default_factory=dict)

    @cached_property
    def rows(self) -> Rows:
        e = self.entry
        flow, output = (tuple(one_sided(row, e.outer) for row in rows) for rows in (e.flow, e.output))
        return Rows(e.states, flow, e.outputs, output, e.inner or {})

    @cached_property
    def chains(self) -> Chains:
        return levelwise(self.rows)

    @property
    def single(self) -> bool:
        return len(self.entry.output) == 1

    @cached_property
    def measured(self) -> Shape | None:
        """The first shape of the gains a_i, CONSTANT or MEASURED, that
        the model's only chain of integrators is proved to have."""
        shapes = (Shape.CONSTANT, Shape.MEASURED)
        return next((shape for shape in shapes if self.single and self.chains.answer(shape)[0]), None)

    @cached_property
    def regular_slopes(self) -> bool | None:
        """Whether in every chain z_i' = f_i(z_1 .. z_(i+1)) each df_i/dz_(i+1), and every output's dh/dz_1, is nonzero
        in the ranges. None if an f_i may jump in z_(i+1) or be undefined, which the derivative does not reveal."""
        links = [link for chain in self.chains.links for link in chain]
        regular = _signed((link.gain if link.affine else link.slope for link in links), self)
        if not regular:
            return regular if self.entry.boxed else None
        for link in links:
            parts_in_state = (part for part in parts(link.row) if part.has(link.state))
            if link.jumps or possibly_undefined(
                parts_in_state, self.entry.outer
            ):  # as the poles of atan(tan x), of slope 1
                return None
        return True

    @cached_property
    def gains(self) -> tuple[sp.Expr, ...]:
        """The gains a_1 .. a_(n-1) of z_i' = a_i z_(i+1) + b_i."""
        return tuple(link.gain for link in self.chains.links[0][1:])

    @cached_property
    def remainders(self) -> tuple[sp.Expr, ...]:
        """The terms b_1 .. b_n of z_i' = a_i z_(i+1) + b_i."""
        links = self.chains.links[0]
        return (*(link.offset for link in links[1:]), self.rows.rate(links[-1].state))


def _ranks(forms: _Forms) -> Iterator[Answer]:
    e, before = forms.entry, perf_counter()
    ranks = observability(Model(e.flow, e.output, e.states, e.inputs, e.unknown or e.known), sides=e.outer)
    yield "seconds", round(perf_counter() - before, 5)
    for which, rank in (("params_known", ranks.known), ("joint", ranks.joint)):
        yield f"observable_{which}", [s.name for s in rank.observable] if rank.final else None
        yield f"rank_{which}", rank.rank if rank.final else None


def _uniform_structure(forms: _Forms) -> Iterator[Answer]:
    if forms.single:
        answer, _ = forms.chains.answer(Shape.UNIFORM)
        yield "uof_structure", answer
        if answer or forms.measured:
            yield "order", [s.name for s in forms.chains.order]
        if answer is False:
            yield "uof", False


def _triangular(forms: _Forms) -> Iterator[Answer]:
    if not forms.single:
        return
    refuted = [forms.chains.answer(shape)[0] is False for shape in (Shape.CONSTANT, Shape.MEASURED)]
    regular = _regular(forms.gains, forms) if forms.measured and _pure(forms.chains, forms) else None
    constant = regular if forms.measured is Shape.CONSTANT else None
    yield "triangular", False if refuted[0] else constant
    yield "triangular_uy", False if refuted[1] else regular


def _pure(chains: Chains, forms: _Forms) -> bool:
    """Return whether each output is proved to be c(u) z_1 with c
    nonzero, z_1 the first state of its chain of integrators."""
    heads = [links[0] for links in chains.links]
    plain = all(is_zero(head.offset, forms.rows.box) for head in heads)
    return plain and _regular([head.gain for head in heads], forms) is True


def _regular(slopes: Iterable[sp.Expr], forms: _Forms) -> bool | None:
    return _signed(slopes, forms) if forms.entry.boxed else True


def _signed(slopes: Iterable[sp.Expr], forms: _Forms) -> bool | None:
    answers = []
    for slope in slopes:
        if slope not in forms.signs:
            forms.signs[slope] = _sign(slope, forms.entry)
        answers.append(forms.signs[slope])
    return False if False in answers else None if None in answers else True


def _sign(slope: sp.Expr, entry: Entry) -> bool | None:
    outside = nonzero(slope, entry.outer).verdict
    if outside is Verdict.PROVED:
        return True
    if outside is not Verdict.REFUTED or entry.inner is None or not entry.declared(slope):
        return None
    if nonzero(sp.cancel(slope), entry.outer).verdict is Verdict.PROVED:
        return None  # a removable singularity, which can be read either way
    inside = nonzero(slope, entry.inner)
    if inside.verdict is not Verdict.REFUTED or _endless(slope, inside):
        return None
    return False


def _endless(slope: sp.Expr, sign: Sign) -> bool:
    """Return whether the sign of a partial derivative is refuted only because the derivative is not finite at the
    witness, while its range has no values of both signs."""
    least, most = sign.range.least, sign.range.most
    crosses = least is not None and most is not None and least.value < 0 < most.value
    at = {s: sp.Rational(value) for s, value in sign.witness.items()}
    return not crosses and sign_at(slope, at) == "undefined"


def _uniform(forms: _Forms) -> Iterator[Answer]:
    if forms.single and forms.chains.answer(Shape.UNIFORM)[0]:
        yield "uof", forms.regular_slopes


def _ranges(forms: _Forms) -> Iterator[Answer]:
    if forms.measured and forms.entry.boxed:
        magnitudes = [_magnitude(gain, forms.entry) for gain in forms.gains]
        yield "a_ranges", None if None in magnitudes else magnitudes


def _magnitude(gain: sp.Expr, entry: Entry) -> list[float] | None:
    """Return the ends of the range of |a|, a the gain; the lower end is positive if a is proved to be nonzero."""
    enclosure, sign = bound(gain, entry.outer), nonzero(gain, entry.outer)
    if not enclosure.finite:
        return None
    low, high = enclosure.low, enclosure.high
    if sign.verdict is Verdict.PROVED:
        least, most = (low, high) if sign.sign > 0 else (-high, -low)
        return [max(least, float(sign.margin)), most]
    return [max(low, -high, 0.0), max(-low, high)]


def _several(forms: _Forms) -> Iterator[Answer]:
    shapes: dict[str, Callable[[], Chains]] = {
        "mimo_levelwise": lambda: forms.chains,
        "mimo_cascade": lambda: cascade(forms.rows),
    }
    for field, make in shapes.items():
        chains = make()
        answer, _ = chains.answer(Shape.CONSTANT)
        if answer:  # None if a gain may vanish
            gains = [link.gain for links in chains.links for link in links[1:]]
            answer = True if _pure(chains, forms) and _regular(gains, forms) else None
        yield field, answer
    answer, _ = forms.chains.answer(Shape.UNIFORM)
    yield "mimo_uof", forms.regular_slopes if answer else answer


def _gauthier_bornard(forms: _Forms) -> Iterator[Answer]:
    e = forms.entry
    condition = gauthier_bornard(Model(e.flow, e.output, e.states, e.inputs))
    yield "gb_uniform", condition.answer if condition.applies else "na"


def _bounds(forms: _Forms) -> Iterator[Answer]:
    e, faults = forms.entry, []
    ranges: list[list[float] | None] = [None] * len(e.queries)
    for k, text in enumerate(e.queries):
        try:
            one = bound(parse(text, e.symbols), e.outer)
        except HgogenError as error:
            faults.append(f"bound_queries, {text!r}: {error}")
            continue
        ranges[k] = [one.low, one.high] if one.finite else None
        yield "bounds", list(ranges)
        if not one.defined:
            yield "note", f"bound_queries, {text!r}: {one.note}"
    if faults:
        yield "error", "; ".join(faults)


def _singular(forms: _Forms) -> Iterator[Answer]:
    e = forms.entry
    factors = singular_set(e.flow, e.output, e.states, e.inputs)
    yield "singular", [str(factor) for factor in factors] if isinstance(factors, tuple) else factors


def _lipschitz(forms: _Forms) -> Iterator[Answer]:
    e = forms.entry
    if forms.measured and e.boxed:
        answer = _is_lipschitz(forms.remainders, e)
        if answer and possibly_undefined((*e.flow, *e.output), e.outer):
            answer = None  # a part of the model may be undefined on the box
        yield "lipschitz", answer


def _is_lipschitz(remainders: Sequence[sp.Expr], entry: Entry) -> bool | None:
    outside = lipschitz_bound(remainders, entry.states, entry.outer, relative=1.0).verdict
    if outside is Verdict.PROVED:
        return True
    if outside is not Verdict.REFUTED or entry.inner is None or not all(map(entry.declared, remainders)):
        return None
    return False if lipschitz_bound(remainders, entry.states, entry.inner).verdict is Verdict.REFUTED else None


_QUESTIONS: dict[str, Callable[[_Forms], Iterator[Answer]]] = {
    "observability": _ranks,
    "structure": _uniform_structure,
    "singular set": _singular,
    "triangular form": _triangular,
    "uniform form": _uniform,
    "ranges of gains": _ranges,
    "forms of several outputs": _several,
    "uniform observability": _gauthier_bornard,
    "bounds": _bounds,
    "Lipschitz constant": _lipschitz,
}

MEMORY = 4 << 30  # bytes of address space of one worker
_OVER = getattr(signal, "SIGPROF", None)  # the signal that ends a process after its processor time
_ON_THE_CLOCK = 10 if _OVER else 1  # limit by the wall clock over that of the processor
Work = Callable[[Any], Iterable[Any]]


class End(Enum):
    """The end of a worker's task: done, past its time limit, or crashed."""

    DONE = "done"
    LATE = "past its time"
    CRASHED = "crashed"


@dataclass(frozen=True)
class Event:
    """A result of the task with number `task`, or the end of the task (then `result` is None)."""

    task: int
    result: Any
    end: End | None = None


@dataclass(frozen=True, eq=False)
class _Worker:
    """A worker process with its pipe, the number of its task (None: not ready), and the time at which the task is
    stopped."""

    process: BaseProcess
    pipe: Connection
    task: int | None = None
    deadline: float = float("inf")


def run(work: Work, tasks: Sequence[Any], *, limit: float, processes: int | None = None) -> Iterator[Event]:
    """Yield the results of `work(task)` for all tasks as soon as they come, in any order; the last event of each task
    has `Event.end` set.

    Args: `work`: a top-level function whose results can be pickled; `limit`: seconds of the processor for each task,
    and ten times as many by the wall clock; `processes`: by default one for each core.
    """
    methods = multiprocessing.get_all_start_methods()
    context = multiprocessing.get_context("forkserver" if "forkserver" in methods else "spawn")
    if "forkserver" in methods:
        context.set_forkserver_preload(["__main__", work.__module__])
    unassigned = iter(range(len(tasks)))
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    workers = [_start(context, work, limit) for _ in range(min(processes or cores, len(tasks)))]
    try:
        while workers:
            first = min(worker.deadline for worker in workers)
            seconds = None if first == float("inf") else max(first - monotonic(), 0)
            ready, now = wait([worker.pipe for worker in workers], seconds), monotonic()
            for worker in [one for one in workers if one.pipe in ready or one.deadline <= now]:
                workers.remove(worker)
                events, following = _receive(worker, unassigned, tasks, limit)
                if following:
                    workers.append(following)
                elif events and events[-1].end in (End.LATE, End.CRASHED):
                    workers.append(_start(context, work, limit))
                yield from events
        yield from (Event(task, None, End.CRASHED) for task in unassigned)  # if no process starts
    finally:
        for worker in workers:
            _end(worker)


def _start(context: Any, work: Work, limit: float) -> _Worker:
    ours, theirs = context.Pipe()
    process = context.Process(target=_serve, args=(theirs, work, limit), daemon=True)
    process.start()
    theirs.close()
    return _Worker(process, ours)


def _serve(pipe: Connection, work: Work, limit: float) -> None:
    """Run tasks in a worker process, each within `limit` seconds of CPU time. Ctrl-C is ignored, since the parent ends
    the worker."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    with suppress(ImportError):  # a system without limits
        import resource

        _, hard = resource.getrlimit(resource.RLIMIT_AS)
        soft = MEMORY if hard == resource.RLIM_INFINITY else min(MEMORY, hard)
        resource.setrlimit(resource.RLIMIT_AS, (soft, hard))
    while True:
        pipe.send(("ready", None))
        task = pipe.recv()
        if _OVER:
            signal.setitimer(signal.ITIMER_PROF, limit)
        for result in work(task):
            pipe.send(("result", result))


def _receive(
    worker: _Worker, unassigned: Iterator[int], tasks: Sequence[Any], limit: float
) -> tuple[list[Event], _Worker | None]:
    events: list[Event] = []
    try:
        while worker.pipe.poll():
            kind, result = worker.pipe.recv()
            if kind == "result":
                events.append(Event(worker.task, result))  # type: ignore[arg-type]  # it has a task, since it answers
                continue
            if worker.task is not None:
                events.append(Event(worker.task, None, End.DONE))
            task = next(unassigned, None)
            if task is None:
                _end(worker)
                return events, None
            worker.pipe.send(tasks[task])
            worker = _Worker(worker.process, worker.pipe, task, monotonic() + _ON_THE_CLOCK * limit)
    except (EOFError, OSError):
        _end(worker)
        late = _OVER and worker.process.exitcode == -_OVER
        return [*events, *_ended(worker, End.LATE if late else End.CRASHED)], None
    if worker.deadline <= monotonic():
        _end(worker)
        return [*events, *_ended(worker, End.LATE)], None
    return events, worker


def _ended(worker: _Worker, how: End) -> list[Event]:
    return [] if worker.task is None else [Event(worker.task, None, how)]


def _end(worker: _Worker) -> None:
    worker.process.kill()
    worker.process.join()
    worker.pipe.close()
