"""Many tasks in processes of their own: results stream in, a task past its time is ended, a crash costs one task.

A worker is one process with one pipe. It says ("ready", ..), is handed a task, sends its results as they are found and
is ready again; one that is past its time, or that has died, is replaced. Its time is that of the processor, so that a
busy machine takes none of it; one that sleeps is ended by the clock. A system without such timers has the clock alone.
"""

import multiprocessing
import os
import signal
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from enum import Enum
from multiprocessing.connection import Connection, wait
from multiprocessing.process import BaseProcess
from time import monotonic
from typing import Any

MEMORY = 4 << 30  # bytes of address space of one worker
_OVER = getattr(signal, "SIGPROF", None)  # by which a system ends a process that has used its time of the processor
_ON_THE_CLOCK = 10 if _OVER else 1  # times as long by the clock
Work = Callable[[Any], Iterable[Any]]


class End(Enum):
    """How a task ended."""

    DONE = "done"
    LATE = "past its time"
    CRASHED = "crashed"


@dataclass(frozen=True)
class Event:
    """Something about the task of number `task`: one of its results, or its end (then `result` is None)."""

    task: int
    result: Any
    end: End | None = None


@dataclass(frozen=True, eq=False)
class _Worker:
    """A process, the pipe to it, the number of its task (None: not ready) and when it is past its time."""

    process: BaseProcess
    pipe: Connection
    task: int | None = None
    deadline: float = float("inf")


def run(work: Work, tasks: Sequence[Any], *, limit: float, processes: int | None = None) -> Iterator[Event]:
    """The results of `work(task)` for each task, as they come, in no order; each task ends with one `Event.end`.

    Args: `work`: a function of a module, whose results can be pickled; `limit`: seconds of the processor for each
    task, and ten times as many by the clock; `processes`: by default one for each core.
    """
    methods = multiprocessing.get_all_start_methods()
    context = multiprocessing.get_context("forkserver" if "forkserver" in methods else "spawn")
    if "forkserver" in methods:
        context.set_forkserver_preload(["__main__", work.__module__])
    left = iter(range(len(tasks)))
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    workers = [_start(context, work, limit) for _ in range(min(processes or cores, len(tasks)))]
    try:
        while workers:
            for worker in _due(workers):
                workers.remove(worker)
                events, heard = _heard(worker, left, tasks, limit)
                if heard:
                    workers.append(heard)
                elif events and events[-1].end in (End.LATE, End.CRASHED):
                    workers.append(_start(context, work, limit))
                yield from events
        yield from (Event(task, None, End.CRASHED) for task in left)  # where no process comes up
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
    """The worker's side; a Ctrl-C is for the process that started it, which ends it."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    _bounded()
    while True:
        pipe.send(("ready", None))
        task = pipe.recv()
        if _OVER:
            signal.setitimer(signal.ITIMER_PROF, limit)
        for result in work(task):
            pipe.send(("result", result))


def _bounded() -> None:
    try:
        import resource
    except ImportError:  # a system without limits
        return
    _, hard = resource.getrlimit(resource.RLIMIT_AS)
    soft = MEMORY if hard == resource.RLIM_INFINITY else min(MEMORY, hard)
    resource.setrlimit(resource.RLIMIT_AS, (soft, hard))


def _due(workers: Sequence[_Worker]) -> list[_Worker]:
    """The workers that have said something or are past their time; waits for one."""
    while True:
        first = min(worker.deadline for worker in workers)
        heard = wait(
            [worker.pipe for worker in workers], None if first == float("inf") else max(first - monotonic(), 0)
        )
        now = monotonic()
        due = [worker for worker in workers if worker.pipe in heard or worker.deadline <= now]
        if due:
            return due


def _heard(
    worker: _Worker, left: Iterator[int], tasks: Sequence[Any], limit: float
) -> tuple[list[Event], _Worker | None]:
    """What a worker says, and the worker as it goes on; None where it is at its end."""
    events: list[Event] = []
    try:
        while worker.pipe.poll():
            kind, result = worker.pipe.recv()
            if kind == "result":
                events.append(Event(worker.task, result))  # type: ignore[arg-type]  # it has a task, since it answers
                continue
            if worker.task is not None:
                events.append(Event(worker.task, None, End.DONE))
            task = next(left, None)
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
