"""Does the law of recovery make an estimate worse that nothing disturbs? A survey of shipped models, observers that
they admit, and mismatches between plant and model.

    .venv/bin/python tests/healthy.py [--models a,b] [--observers a,b] [--tenth K] [--half design] [--save FILE]
                                      [--against FILE]

Each pair runs the model's first trial without its jumps under each mismatch, with the law and, where a guard has acted,
without it. Of a run the number is the RMS error over the widths of the ranges, of the worst state. A run is worse
where that is larger by 1.1 times and by .2 % of a range. It counts where the plant stays in its ranges, as the law
may take a plant beyond them for a fault. Pairs with the tunings of the model, and with starting gains of the observers
that have none there. The mismatches of the half "held out" have not been used to choose a number of the law.

`--save` writes the runs, a line of JSON each; `--against` compares with those of another version.
"""

import argparse
import json
import time
from collections.abc import Callable, Iterable, Iterator
from dataclasses import asdict, dataclass
from typing import Any
from unittest import mock

import numpy as np
from recovery import LONGEST, MODELS, calm, model, within

import hgogen as hg
from hgogen.call import CallableStep
from hgogen.errors import HgogenError
from hgogen.run.samples import at_sampling_times
from hgogen.step import _assembled
from hgogen.stepping import recovery
from hgogen.stepping.guards import readings
from hgogen.trial import BadTrial, Plant, Truth, inputs_at, noisy

WORSE, LEAST = 1.1, 2e-3  # times, and of a range
MOST = 60_000  # samples of a run
RESTARTED, PROJECTED = "RESTARTED_FROM_SAMPLE", "PROJECTED_ONTO_RANGES"


@dataclass(frozen=True)
class Mismatch:
    """How the plant and its sensors differ from the model: each parameter by `parameters` of its value, up or down as
    `seed` draws; noise `times` as large, and more of `noise` of the span; `bias` of the span; only every `every`-th
    sample."""

    name: str
    parameters: float = 0.0
    seed: int = 0
    times: float = 1.0
    noise: float = 0.0
    bias: float = 0.0
    every: int = 1


DESIGN = (
    Mismatch("none"),
    Mismatch("parameters 10 %, 1", 0.1, 1),
    Mismatch("parameters 20 %, 2", 0.2, 2),
    Mismatch("parameters 30 %, 1", 0.3, 1),
    Mismatch("noise x3", times=3),
    Mismatch("noise 4 %", noise=0.04),
    Mismatch("every 50th", every=50),
)
HELD_OUT = (
    Mismatch("parameters 10 %, 2", 0.1, 2),
    Mismatch("parameters 20 %, 1", 0.2, 1),
    Mismatch("parameters 30 %, 2", 0.3, 2),
    Mismatch("noise x10", times=10),
    Mismatch("noise 2 %", noise=0.02),
    Mismatch("every 10th", every=10),
    Mismatch("bias 4 %", bias=0.04),
    Mismatch("mix", 0.15, 3, times=2, noise=0.01, bias=0.01, every=2),
)
HALVES = {"design": DESIGN, "held out": HELD_OUT, "both": (*DESIGN, *HELD_OUT)}


@dataclass(frozen=True)
class Run:
    """A run: `error` with the law, `without` it, where a guard acted, else the same; when it `restarted` and
    `projected`, in the model's time; whether the plant was `inside` its ranges."""

    model: str
    observer: str
    mismatch: str
    inside: bool
    error: float
    without: float
    restarted: list[float]
    projected: list[float]

    @property
    def pair(self) -> tuple[str, str, str]:
        """What was run."""
        return self.model, self.observer, self.mismatch


def pairs() -> Iterator[tuple[str, str]]:
    """(model, observer) of every shipped model with a trial."""
    for path in sorted(path for path in MODELS.glob("*.*") if path.is_file()):
        if model(path.stem).has("trial"):
            names = dict.fromkeys((*model(path.stem).tuning.tables, *hg.observers.__all__))
            yield from ((path.stem, name) for name in names)


def lawless(make: Callable[[], CallableStep]) -> CallableStep:
    """A step whose law of recovery never acts."""
    _assembled.cache_clear()
    with mock.patch.object(recovery.Recovery, "signs", ()):
        step = make()
    _assembled.cache_clear()
    return step


def truth_of(name: str, step: CallableStep, mismatch: Mismatch) -> Truth:
    """The plant's truth. Raises: `BadTrial`."""
    system = step.observer.form.system
    plant = system if system.origin is None else system.origin.plant
    trial = calm(model(name).trials()[0])
    values = np.array([float(p.nominal or 0) for p in plant.parameters])
    signs = np.random.default_rng([mismatch.seed, 5]).choice([-1.0, 1.0], len(values))
    moved = values * (1 + mismatch.parameters * signs)
    return Plant(plant, trial, step.dt, plant.parameters).truth(trial.start, moved)


def signals(name: str, step: CallableStep, truth: Truth, mismatch: Mismatch) -> tuple[np.ndarray, np.ndarray]:
    """Inputs and outputs as the step reads them."""
    system = step.observer.form.system
    plant = system if system.origin is None else system.origin.plant
    trial, rng = calm(model(name).trials()[0]), np.random.default_rng(11)
    y = truth.y + mismatch.times * (noisy(plant, truth, trial, trial.seeds[:1])[0] - truth.y)
    spans = np.array([high - low for low, high in readings(step.observer.form)])[: y.shape[1]]
    spans = np.where(np.isfinite(spans), spans, np.ptp(truth.y, axis=0))
    y = y + spans * (mismatch.bias + mismatch.noise * rng.standard_normal(y.shape))
    y[np.arange(len(y)) % mismatch.every != 0] = np.nan
    return inputs_at(system, trial, truth.t), at_sampling_times(step, y)


def surveyed(name: str, observer: str, mismatches: Iterable[Mismatch]) -> Iterator[Run]:
    """Every mismatch of a pair. Raises: `HgogenError` for an observer that the model does not admit."""
    step, without = model(name).step(observer), None
    bits = {bit.name: k for k, bit in enumerate(step.layout.bits)}
    for mismatch in mismatches:
        try:
            truth = truth_of(name, step, mismatch)
        except BadTrial:
            continue
        last = min(len(truth.t), MOST, LONGEST)
        u, y = (values[:last] for values in signals(name, step, truth, mismatch))
        plant = step.states
        inside = all(
            bool(within(x[:last], *s.interval).all()) for s, x in zip(plant, truth.x.T, strict=True) if s.bounded
        )
        widths = np.array([s.interval[1] - s.interval[0] for s in plant])
        widths = np.where(np.isfinite(widths), widths, np.ptp(truth.x, axis=0) + 1e-300)

        def error(one: CallableStep) -> tuple[float, np.ndarray]:
            one.reset()
            with np.errstate(all="ignore"):
                run = one.run(u=u, y=y, engine="c")  # noqa: B023
            return float(np.sqrt((((run.x - truth.x[:last]) / widths) ** 2).mean(axis=0)).max()), run.status  # noqa: B023

        now, status = error(step)
        times = [
            truth.t[np.flatnonzero((status >> bits[bit]) & 1)].tolist() if bit in bits else []
            for bit in (RESTARTED, PROJECTED)
        ]
        then = now
        if any(times):
            without = without or lawless(lambda: model(name).step(observer))
            then = error(without)[0]
        yield Run(name, observer, mismatch.name, inside, now, then, *times)


def worse(one: float, other: float) -> bool:
    """Whether the first of two errors is the larger one."""
    return not one <= max(WORSE * other, other + LEAST)


def line(run: Run, other: float, what: str) -> str:
    """A row of the table of what became worse."""
    first = ", ".join(f"{t:.3g}" for t in (run.restarted or run.projected)[:3])
    acted = f"{len(run.restarted)} restarts, {len(run.projected)} projections, first at {first or '-'}"
    return f"  {run.model} {run.observer}, {run.mismatch}: {run.error:.4f}, {what} {other:.4f}; {acted}"


def report(runs: list[Run], before: dict[tuple[str, str, str], Run]) -> Iterator[str]:
    """What the law does, in counts and run by run."""
    sound = [run for run in runs if run.inside]
    for names, each in (("all", runs), ("the plant in its ranges", sound)):
        acted = [run for run in each if run.restarted or run.projected]
        yield (
            f"{names}: {len(each)} runs, {sum(map(bool, (r.restarted for r in each)))} with a restart, "
            f"{sum(map(bool, (r.projected for r in each)))} with a projection, "
            f"{sum(worse(r.error, r.without) for r in acted)} worse than without the law, "
            f"{sum(worse(r.without, r.error) for r in acted)} better"
        )
    yield from (line(run, run.without, "without the law") for run in sound if worse(run.error, run.without))
    known = [(run, before[run.pair]) for run in sound if run.pair in before]
    if known:
        count = [sum(worse(a.error, b.error) for a, b in known), sum(worse(b.error, a.error) for a, b in known)]
        yield f"of {len(known)} runs of the other version {count[0]} are worse now, {count[1]} better"
        yield from (line(run, other.error, "before") for run, other in known if worse(run.error, other.error))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--models", default="")
    parser.add_argument("--observers", default="")
    parser.add_argument("--tenth", type=int, default=-1, help="only every tenth pair, from this one on")
    parser.add_argument("--half", choices=HALVES, default="both")
    parser.add_argument("--save", type=argparse.FileType("w"))
    parser.add_argument("--against", type=argparse.FileType("r"))
    options = parser.parse_args()
    wanted = list(pairs())
    if options.models:
        wanted = [p for m in options.models.split(",") for p in wanted if p[0] == m]
    if options.observers:
        wanted = [p for p in wanted if p[1] in options.observers.split(",")]
    if options.tenth >= 0:
        wanted = wanted[options.tenth :: 10]
    runs: list[Run] = []
    for name, observer in wanted:
        begun = time.process_time()
        try:
            each = list(surveyed(name, observer, HALVES[options.half]))
        except HgogenError as error:
            print(f"{name} {observer}: {str(error).splitlines()[0][:100]}", flush=True)
            continue
        runs += each
        acted = sum(bool(run.restarted or run.projected) for run in each)
        harmed = sum(run.inside and worse(run.error, run.without) for run in each)
        seconds = f"({time.process_time() - begun:.1f} s)"
        print(f"{name} {observer}: {len(each)} runs, {acted} with a guard, {harmed} worse {seconds}", flush=True)
        if options.save:
            options.save.writelines(json.dumps(asdict(run)) + "\n" for run in each)
            options.save.flush()
    before: dict[tuple[str, str, str], Any] = {}
    for row in options.against or ():
        run = Run(**json.loads(row))
        before[run.pair] = run
    print("\n".join(report(runs, before)))


if __name__ == "__main__":
    main()
