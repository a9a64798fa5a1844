"""Does an observer find its way back after a bounded fault? A survey of shipped models, their tunings, and faults.

    .venv/bin/python tests/recovery.py [--models a,b] [--observers a,b] [--tenth K]

For each pair of a model and a tuning the trial is run with true samples for a while, then one fault is laid on, then
samples are true again. The estimate is *lost* where it is out of its band, for more than a tenth of a settling time,
later than ten of the pair's settling times after the fault. The faults are listed here, before any run; those of the
half "held out" have not been used to choose a number of the law of recovery (`hgogen/stepping/recovery.py`).

The band of a state is three times its largest error in the trial's steady part, and 2 % of its declared range; after
a jump at least that of the observer which is reset there, as the plant now moves elsewhere. A pair settles where the
trial from its own start ends in the band. Its settling time is the longest from the trial's start, from resets along
it, and of a settled estimate that is moved by a sixth of its outer box (a filter at rest corrects at another pace than
one that has just begun); at least 20 samples.
"""

import argparse
import time
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any, Literal, get_args

import numpy as np
from plants import loaded

from hgogen.call import CallableStep
from hgogen.emit import layout
from hgogen.emit.saved import sealed
from hgogen.errors import HgogenError
from hgogen.model import Model
from hgogen.run.samples import at_sampling_times
from hgogen.trial import BadTrial, Jump, Trial, Truth, inputs_at, noisy, simulate

MODELS = Path(__file__).resolve().parents[1] / "models"
WAIT = 10  # settling times that an estimate has to come back
BAND = 3  # largest errors of a steady part
LONGEST = 400_000  # samples of a record

# --- faults -------------------------------------------------------------------------------------------------

Kind = Literal["silent", "random", "stuck", "spikes", "inputs", "gains", "jump", "state"]
KINDS: tuple[Kind, ...] = get_args(Kind)


@dataclass(frozen=True)
class Fault:
    """What goes wrong: `value` as its kind says, for `length` settling times, and at least 5 samples, of an estimate
    that has settled, or from the `first` sample on.

    silent   no sample                          random   samples uniform over the ranges, widened by `value` widths
    stuck    samples at the share `value` of the range       spikes   every `value`-th sample is off by .9 of a width
    inputs   each input at the share `value` of its range, NaN for no number, "random" for any in the range
    gains    each gain at the share `value` of its logarithmic range, then put back
    jump     the plant's states jump to the shares `value` of their ranges, one after the other and again from the first
    state    memory: "low", "high", "random" an estimate in its outer box; "all" every number at random in its box
    """

    name: str
    kind: Kind
    value: Any = None
    length: float = 0.0
    first: bool = False


DESIGN = (
    Fault("silent .1", "silent", length=0.1),
    Fault("silent 3", "silent", length=3),
    Fault("random 1", "random", 1.0, 1),
    Fault("random in range", "random", 0.0, 1),
    Fault("random long", "random", 1.0, 4),
    Fault("stuck low", "stuck", 0.0, 1),
    Fault("stuck above", "stuck", 1.9, 1),
    Fault("stuck middle", "stuck", 0.5, 3),
    Fault("spikes 2", "spikes", 2, 1),
    Fault("spikes 10", "spikes", 10, 2),
    Fault("inputs low", "inputs", 0.0, 1),
    Fault("inputs random", "inputs", "random", 1),
    Fault("inputs lost", "inputs", float("nan"), 3),
    Fault("gains low", "gains", 0.0, 1),
    Fault("gains high", "gains", 1.0, 1),
    Fault("gains low long", "gains", 0.0, 4),
    Fault("jump 1", "jump", (0.2, 0.8)),
    Fault("jump 2", "jump", (0.7, 0.3)),
    Fault("estimate low", "state", "low"),
    Fault("estimate random 1", "state", ("random", 1)),
    Fault("estimate random 2", "state", ("random", 2)),
    Fault("memory 1", "state", ("all", 1)),
    Fault("memory 2", "state", ("all", 2)),
    Fault("memory 3", "state", ("all", 3)),
    Fault("silent .5", "silent", length=0.5),
    Fault("silent 10", "silent", length=10),
    Fault("random .3", "random", 0.5, 0.3),
    Fault("random 2", "random", 1.0, 2),
    Fault("random wide", "random", 0.2, 6),
    Fault("stuck high", "stuck", 1.0, 1),
    Fault("stuck below", "stuck", -0.9, 1),
    Fault("stuck quarter", "stuck", 0.25, 5),
    Fault("spikes 3", "spikes", 3, 2),
    Fault("spikes 30", "spikes", 30, 4),
    Fault("inputs high", "inputs", 1.0, 1),
    Fault("inputs random long", "inputs", "random", 4),
    Fault("inputs middle", "inputs", 0.5, 3),
    Fault("gains in between", "gains", 0.3, 1),
    Fault("gains high long", "gains", 1.0, 4),
    Fault("gains low brief", "gains", 0.0, 0.2),
    Fault("jump 3", "jump", (0.1, 0.5, 0.9)),
    Fault("jump 4", "jump", (0.9, 0.4)),
    Fault("estimate high", "state", "high"),
    Fault("estimate random 3", "state", ("random", 3)),
    Fault("estimate random 4", "state", ("random", 4)),
    Fault("memory 4", "state", ("all", 4)),
    Fault("memory 5", "state", ("all", 5)),
    Fault("memory 6", "state", ("all", 6)),
)
HELD_OUT = (
    Fault("silent .2", "silent", length=0.2),
    Fault("silent 1", "silent", length=1),
    Fault("silent 2", "silent", length=2),
    Fault("silent 6", "silent", length=6),
    Fault("random brief", "random", 1.0, 0.05),
    Fault("random .7", "random", 0.3, 0.7),
    Fault("random beyond", "random", 2.0, 1.5),
    Fault("random in range long", "random", 0.0, 5),
    Fault("random 3", "random", 0.8, 3),
    Fault("stuck near low", "stuck", 0.05, 2),
    Fault("stuck near high", "stuck", 0.95, 2),
    Fault("stuck half above", "stuck", 1.5, 0.5),
    Fault("stuck half below", "stuck", -0.5, 3),
    Fault("stuck high long", "stuck", 1.0, 6),
    Fault("stuck low brief", "stuck", 0.0, 0.1),
    Fault("spikes 4", "spikes", 4, 1),
    Fault("spikes 5", "spikes", 5, 3),
    Fault("spikes 7", "spikes", 7, 0.5),
    Fault("spikes 20", "spikes", 20, 2),
    Fault("spikes each", "spikes", 1, 1.5),
    Fault("inputs low long", "inputs", 0.0, 4),
    Fault("inputs high brief", "inputs", 1.0, 0.3),
    Fault("inputs beyond", "inputs", 1.5, 1),
    Fault("inputs far beyond", "inputs", 50.0, 2),
    Fault("inputs far below", "inputs", -50.0, 2),
    Fault("inputs quarter", "inputs", 0.25, 2),
    Fault("inputs random 2", "inputs", "random", 2),
    Fault("inputs lost brief", "inputs", float("nan"), 0.5),
    Fault("gains tenth", "gains", 0.1, 2),
    Fault("gains half", "gains", 0.5, 2),
    Fault("gains nearly all", "gains", 0.9, 2),
    Fault("gains high brief", "gains", 1.0, 0.2),
    Fault("gains low longer", "gains", 0.0, 6),
    Fault("jump 5", "jump", (0.3, 0.6)),
    Fault("jump 6", "jump", (0.6, 0.2, 0.4)),
    Fault("jump 7", "jump", (0.5,)),
    Fault("jump 8", "jump", (0.15, 0.85, 0.5)),
    Fault("jump 9", "jump", (0.8, 0.8, 0.2)),
    Fault("estimate random 5", "state", ("random", 5)),
    Fault("estimate random 6", "state", ("random", 6)),
    Fault("estimate random 7", "state", ("random", 7)),
    Fault("estimate random 8", "state", ("random", 8)),
    Fault("memory 7", "state", ("all", 7)),
    Fault("memory 8", "state", ("all", 8)),
    Fault("memory 9", "state", ("all", 9)),
    Fault("memory 10", "state", ("all", 10)),
    Fault("memory 11", "state", ("all", 11)),
    Fault("memory 12", "state", ("all", 12)),
)
AT_START = (
    Fault("random 1 at start", "random", 1.0, 1, first=True),
    Fault("stuck low at start", "stuck", 0.0, 1, first=True),
    Fault("spikes 2 at start", "spikes", 2, 1, first=True),
    Fault("random in range at start", "random", 0.0, 1, first=True),
    Fault("stuck high long at start", "stuck", 1.0, 3, first=True),
    Fault("random long at start", "random", 1.0, 4, first=True),
)
FAULTS = (*DESIGN, *HELD_OUT, *AT_START)


def half(fault: Fault) -> str:
    return "design" if fault in (*DESIGN, *AT_START[:3]) else "held out"


# --- a pair -------------------------------------------------------------------------------------------------


@cache
def model(name: str) -> Model:
    return loaded(next(path for path in MODELS.glob(f"{name}.*") if path.suffix in (".py", ".toml")))


def pairs() -> Iterator[tuple[str, str]]:
    """(model, tuning) of every shipped model with a trial."""
    for path in sorted(path for path in MODELS.glob("*.*") if path.is_file()):
        if model(path.stem).has("trial"):
            yield from ((path.stem, name) for name in model(path.stem).tuning.tables)


def calm(trial: Trial) -> Trial:
    """The trial without its jumps, and without an end of its steady part that is of them."""
    return replace(trial, jumps=(), steady=None, name=f"{trial.name}, calm")


def within(x: np.ndarray, low: float, high: float) -> np.ndarray:
    """Whether values are in a range, or beyond it by no more than a hundredth."""
    slack = 0.01 * (high - low)
    return np.asarray((x >= low - slack) & (x <= high + slack))


@cache
def motion(name: str, dt: float, duration: float, jump: tuple[float, tuple[float, ...]] | None = None) -> Truth | None:
    """The truth of a model's first trial for as long, with a jump at a time; None where it cannot be integrated or
    leaves the declared ranges by a hundredth."""
    plant, trial = model(name).plant, calm(model(name).trials()[0])
    if jump:
        ranges = [s.interval if s.bounded else (-1.0, 1.0) for s in plant.states]
        shares = [jump[1][i % len(jump[1])] for i in range(len(ranges))]
        values = [low + share * (high - low) for (low, high), share in zip(ranges, shares, strict=True)]
        states = zip(plant.states, values, strict=True)
        trial = replace(trial, jumps=tuple(Jump(jump[0], s.name, value) for s, value in states))
    try:
        truth = simulate(plant, replace(trial, duration=duration), dt)
    except BadTrial:
        return None
    inside = [bool(within(x, *s.interval).all()) for s, x in zip(plant.states, truth.x.T, strict=True) if s.bounded]
    return truth if all(inside) else None


def horizon(name: str, dt: float, wanted: float) -> Truth:
    """The truth for `wanted` and more where the plant goes on so long in its ranges, else for half as long, and so on
    down to the trial's own duration."""
    own = model(name).trials()[0].duration
    while wanted > own:
        truth = motion(name, dt, wanted)
        if truth is not None:
            return truth
        wanted /= 1.5
    truth = motion(name, dt, own)
    return simulate(model(name).plant, calm(model(name).trials()[0]), dt) if truth is None else truth


@dataclass
class Pair:
    """A step with its record; `band` (n), `settling` time in samples, `begin` of the fault in samples."""

    name: str
    tuning: str
    step: CallableStep
    truth: Truth
    u: np.ndarray
    y: np.ndarray
    band: np.ndarray
    settling: int
    settles: bool
    begin: int


def record(name: str, step: CallableStep, truth: Truth) -> tuple[np.ndarray, np.ndarray]:
    """Inputs and noisy outputs of a truth."""
    loaded, trial = model(name), calm(model(name).trials()[0])
    system = step.observer.form.system
    plant = system if system.origin is None else system.origin.plant
    y = noisy(plant, truth, trial, trial.seeds[:1])[0]
    assert loaded.plant.outputs
    return inputs_at(system, replace(trial, duration=truth.t[-1]), truth.t), at_sampling_times(step, y)


def settled(error: np.ndarray, band: np.ndarray, window: int = 1) -> int:
    """The sample from which on errors (N, n) stay in the band, but for a tenth of the samples of each window; N for
    none."""
    out = ~(np.abs(error) <= band).all(axis=1)
    windows = [out[k : k + window].mean() > 0.1 for k in range(0, len(out), window)]
    often = np.repeat(np.array(windows, bool), window)[: len(out)]
    last = np.flatnonzero(out & often)
    return int(last[-1]) + 1 if len(last) else 0


def prepared(name: str, tuning: str, step: CallableStep) -> Pair:
    """A pair's record, band and settling time."""
    trial = model(name).trials()[0]
    truth = horizon(name, step.dt, min(3 * trial.duration, LONGEST * step.dt))
    u, y = record(name, step, truth)
    own = min(round(trial.duration / step.dt) + 1, len(y))
    step.reset()
    x = step.run(u=u[:own], y=y[:own], engine="c").x
    widths = np.array(
        [
            s.interval[1] - s.interval[0] if s.bounded else np.ptp(truth.x[:, i]) or 1.0
            for i, s in enumerate(step.states)
        ]
    )
    error = x - truth.x[:own]
    quiet = np.abs(error[round(0.9 * own) :]).max(axis=0)
    band = BAND * quiet + 0.02 * widths
    settles = bool((quiet < 0.25 * widths).all())
    longest = settled(error, band)
    for share, moved in ((0.2, 0.0), (0.4, 0.0), (0.6, 0.0), (0.3, 1.0), (0.3, -1.0)):
        step.reset()
        first = round(share * own)
        if moved:
            step.run(u=u[:first], y=y[:first], engine="c")
            step.restore(corrupted(step, ("moved", moved), np.random.default_rng(0)))
        part = step.run(u=u[first:], y=y[first:], engine="c").x - truth.x[first:]
        reached = settled(part, band)
        longest = max(longest, reached if reached < 0.9 * len(part) else 0)
    settling = max(20, longest)
    begin = min(max(round(0.2 * own), settling), own)
    needed = (begin + (WAIT + 12) * settling) * step.dt
    if needed > truth.t[-1]:
        truth = horizon(name, step.dt, min(needed, LONGEST * step.dt))
        u, y = record(name, step, truth)
    step.reset()
    last = begin + sound(step.run(u=u, y=y, engine="c").x[begin:] - truth.x[begin:], band, settling)
    return Pair(name, tuning, step, truth, u[:last], y[:last], band, settling, settles, begin)


def sound(error: np.ndarray, band: np.ndarray, settling: int) -> int:
    """The samples until an estimate that nothing has disturbed is out of its band for most of a settling time: there
    the plant has gone where this observer does not see it."""
    out = (np.abs(error) > band).any(axis=1)
    bad = [k for k in range(0, len(out), settling) if out[k : k + settling].mean() > 0.5]
    return bad[0] if bad else len(out)


# --- a fault on a pair --------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Outcome:
    """`after`: settling times from the fault's end until the estimate is back; `lost`: it was not within `WAIT`;
    `enough`: the record is so long; `flags`: the bits in the last tenth; `recoveries`: samples with the bit
    RESTARTED_FROM_SAMPLE."""

    fault: Fault
    after: float
    lost: bool
    enough: bool
    flags: tuple[str, ...]
    finite: bool
    recoveries: int


def corrupted(step: CallableStep, how: Any, rng: np.random.Generator) -> bytes:
    """The step's state with numbers of the estimate, or all of them, drawn anew."""
    memory = np.frombuffer(bytes(step._kept.state), layout.state_type(step)).copy()
    kind = how[0] if isinstance(how, tuple) else how

    def ends(box: tuple[float, float], size: float = 1e3) -> tuple[float, float]:
        low, high = box
        return max(low, -size), min(high, size)

    def put(view: Any, fields: Iterable[Any]) -> None:
        for field in fields:
            if not (field.outer or kind == "all") or field.name in ("u", "y", "y_valid"):
                continue
            target = view[field.name]
            shape = target.shape
            if field.kind == "index":
                target[...] = rng.integers(0, int(field.high[0]) + 1, shape)
                continue
            if kind == "moved":
                low, high = np.clip(np.array(field.box), -1e3, 1e3).T
                each = (low, high) if field.size > 1 else (low[0], high[0])
                target[...] = np.clip(target + how[1] * (each[1] - each[0]) / 6, *each)
                continue
            values = []
            for box in field.box:
                low, high = ends(box, 1e3) if field.outer else ends(box, 1e6)
                share = {"low": 0.0, "high": 1.0}.get(kind, rng.uniform())
                if not field.outer and low >= 0:  # a size: any power of ten
                    bottom = max(low, 1e-9)
                    values.append(bottom * (max(high, bottom) / bottom) ** share)
                else:
                    values.append(low + share * (high - low))
            target[...] = np.reshape(values, (-1,)) if field.size > 1 else values[0]

    def groups(view: Any, children: Iterable[Any]) -> None:
        for group in children:
            put(view[group.name], group.fields)
            groups(view[group.name], group.groups)

    put(memory, step.layout.state)
    groups(memory, step.layout.groups)
    return sealed(step, step.real, memory.tobytes())


def judge(pair: Pair, fault: Fault, warm: bytes) -> Outcome | None:
    """The fault laid on; None where it cannot be (no input, no jump in the ranges)."""
    step, begin = pair.step, 0 if fault.first else pair.begin
    rng = np.random.default_rng([FAULTS.index(fault), 7])
    count = max(5, round(fault.length * pair.settling)) if fault.length else 0
    truth, u, y = pair.truth, pair.u, pair.y
    if fault.kind == "jump":
        simulated = motion(pair.name, step.dt, truth.t[-1], (truth.t[begin], fault.value))
        if simulated is None:
            return None
        truth = simulated
        u, y = (values[: len(pair.y)] for values in record(pair.name, step, truth))
    if fault.kind == "inputs" and not u.shape[1]:
        return None
    end = min(begin + count, len(y))
    last = min(end + (WAIT + 1) * pair.settling, len(y))
    u, y, band = u[begin:last].copy(), y[begin:last].copy(), pair.band
    if fault.kind == "jump":
        step.reset()
        error = step.run(u=u, y=y, engine="c").x - truth.x[begin:last]
        band = np.maximum(band, BAND * np.abs(error[round(0.9 * len(error)) :]).max(axis=0))
    _disturb(pair, fault, u[:count], y[:count], rng)
    step.reset()
    if not fault.first:
        step.restore(warm)
    if fault.kind == "state":
        step.restore(corrupted(step, fault.value, rng))
    if fault.kind == "gains":
        _tune(step, fault.value)
    with np.errstate(all="ignore"):
        parts = [step.run(u=u[:count], y=y[:count], engine="c")] if count else []
        _tune(step, None)
        parts.append(step.run(u=u[count:], y=y[count:], engine="c"))
    x, status = parts[-1].x, np.concatenate([part.status for part in parts])
    error = x - truth.x[end:last]
    reached = settled(error, band, pair.settling)
    enough = len(error) >= WAIT * pair.settling
    tail = parts[-1].status[-max(1, len(error) // 10) :]
    names = step.flags(np.bitwise_or.reduce(tail)) if len(tail) else ()
    bit = [k for k, b in enumerate(step.layout.bits) if b.name == "RESTARTED_FROM_SAMPLE"]
    recoveries = int(((status >> bit[0]) & 1).sum()) if bit else 0
    lost = reached > WAIT * pair.settling if enough else reached >= len(error)
    return Outcome(fault, reached / pair.settling, lost, enough, names, bool(np.isfinite(x).all()), recoveries)


def _disturb(pair: Pair, fault: Fault, u: np.ndarray, y: np.ndarray, rng: np.random.Generator) -> None:
    if not len(y):
        return
    outputs = pair.step.outputs
    spans = [s.interval if s.bounded else (pair.y[:, j].min(), pair.y[:, j].max()) for j, s in enumerate(outputs)]
    spans = [
        (np.nanmin(pair.y[:, j]), np.nanmax(pair.y[:, j])) if not np.isfinite(s).all() else s
        for j, s in enumerate(spans)
    ]
    if fault.kind in ("random", "stuck", "spikes", "silent"):
        had = np.isfinite(y)
        for j, (low, high) in enumerate(spans):
            width = high - low
            match fault.kind:
                case "silent":
                    y[:, j] = np.nan
                case "random":
                    y[:, j] = rng.uniform(low - fault.value * width, high + fault.value * width, len(y))
                case "stuck":
                    y[:, j] = low + fault.value * width
                case "spikes":
                    y[:: fault.value, j] += 0.9 * width
        y[~had] = np.nan
    if fault.kind == "inputs":
        for j, signal in enumerate(pair.step.inputs):
            low, high = signal.interval if signal.bounded else (-1.0, 1.0)
            if fault.value == "random":
                u[:, j] = rng.uniform(low, high, len(u))
            else:
                u[:, j] = low + fault.value * (high - low)


def _tune(step: CallableStep, share: float | None) -> None:
    """Every gain at a share of its logarithmic range; None: as declared."""
    values = {}
    for field in step.layout.gains:
        if share is None:
            values[field.name] = field.initial
            continue
        ends = [
            (max(low, 1e-6 * abs(v) or 1e-9), high) for (low, high), v in zip(field.box, field.initial, strict=True)
        ]
        values[field.name] = [low * (max(high, low) / low) ** share for low, high in ends]
    if values:
        step.tune(**values)


def undisturbed(name: str, step: CallableStep, seeds: int = 1, jumps: bool = False) -> tuple[float, int]:
    """Of a model's trials, with or without their jumps: the largest share of its limit that a fault count reaches, at
    every few samples, and how many restarts from a sample there are."""
    most, restarts = 0.0, 0
    system = step.observer.form.system
    plant = system if system.origin is None else system.origin.plant
    bits = {b.name: 1 << k for k, b in enumerate(step.layout.bits)}
    kind = layout.state_type(step)
    for trial in model(name).trials():
        trial = trial if jumps else calm(trial)
        truth = simulate(plant, trial, step.dt)
        u = inputs_at(system, trial, truth.t)
        for seed in trial.seeds[:seeds]:
            y = at_sampling_times(step, noisy(plant, truth, trial, [seed])[0])
            step.reset()
            chunk = max(1, len(y) // 1200)
            for k in range(0, len(y), chunk):
                status = step.run(u=u[k : k + chunk], y=y[k : k + chunk], engine="c").status
                restarts += int((status & bits.get("RESTARTED_FROM_SAMPLE", 0) != 0).sum())
                memory = np.frombuffer(bytes(step._kept.state), kind)
                most = max([most, *(abs(float(memory[sign.count][0])) / sign.wait for sign in step.code.signs)])
    return most, restarts


# --- the survey ---------------------------------------------------------------------------------------------


def survey(name: str, tuning: str, faults: Iterable[Fault] = FAULTS) -> tuple[Pair, list[Outcome]]:
    """Every fault on a pair."""
    step = model(name).step(tuning)
    pair = prepared(name, tuning, step)
    step.reset()
    step.run(u=pair.u[: pair.begin], y=pair.y[: pair.begin], engine="c")
    warm = step.save()
    return pair, [outcome for fault in faults if (outcome := judge(pair, fault, warm))]


def line(pair: Pair, outcomes: list[Outcome]) -> str:
    """A row of the table."""
    lost = [o for o in outcomes if o.lost and o.enough]
    short = [o for o in outcomes if o.lost and not o.enough]
    worst = max((o.after for o in outcomes if not o.lost), default=0.0)
    causes = ", ".join(f"{o.fault.name} [{'+'.join(o.flags)}]" for o in lost)
    if short:
        causes += f"; record too short to tell: {', '.join(o.fault.name for o in short)}"
    head = f"{pair.name:20} {pair.tuning:20} T {pair.settling * pair.step.dt:9.3g} s {pair.settling:7d}"
    kinds = "" if pair.settles else " (its trial does not settle)"
    return f"{head} faults {len(outcomes):3d} lost {len(lost):3d} worst {worst:5.2f} T{kinds} {causes}"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--models", default="")
    parser.add_argument("--observers", default="")
    parser.add_argument("--tenth", type=int, default=-1, help="only every tenth pair, from this one on")
    options = parser.parse_args()
    wanted = list(pairs())
    if options.models:
        wanted = [p for m in options.models.split(",") for p in wanted if p[0] == m]
    if options.observers:
        wanted = [p for p in wanted if p[1] in options.observers.split(",")]
    if options.tenth >= 0:
        wanted = wanted[options.tenth :: 10]
    totals: dict[str, list[int]] = {"design": [0, 0], "held out": [0, 0]}
    for name, tuning in wanted:
        begun = time.process_time()
        try:
            pair, outcomes = survey(name, tuning)
        except HgogenError as error:
            print(f"{name} {tuning}: {error}", flush=True)
            continue
        if pair.step.code.signs:
            share, restarts = undisturbed(name, pair.step)
            _, after = undisturbed(name, pair.step, jumps=True)
            quiet = f"undisturbed: fault count up to {share:.2f} of its limit, {restarts} restarts"
            print(f"    {quiet}, with the trial's jumps {after}", end="; ")
        print(line(pair, outcomes), f"({time.process_time() - begun:.1f} s)", flush=True)
        for o in outcomes if pair.settles else ():
            totals[half(o.fault)][0] += 1
            totals[half(o.fault)][1] += o.lost and o.enough
    for which, (count, lost) in totals.items():
        print(f"{which}: {count} faults, {lost} lost")


if __name__ == "__main__":
    main()
