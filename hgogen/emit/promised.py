"""What emitted code says of its errors as it runs, in every language: proved bounds, and all that they assume.

Numbers that a solver leads to have two digits, rounded to the safe side, so that another version of it seldom writes
others; what a user has given stands as it is.
"""

from collections.abc import Callable, Iterator, Mapping
from fractions import Fraction

import sympy as sp

from hgogen.program import Place
from hgogen.prove.questions import Each, Signed
from hgogen.sentence import down, same, up
from hgogen.signal import Signal, pace
from hgogen.step import Step
from hgogen.stepping.guards import STEP_BITS

_CLOSE = Fraction(11, 10)  # of a bound, to which errors have come when they are said to have settled
_DIGITS = 2
_UNPROVED = "nothing is proved of how far its estimate errs; `hgogen check` says why"
_USUAL = "OUTSIDE_BOX"  # which a proof counts with
_UNCOUNTED = "Not counted: the rounding of floating-point numbers."
_COUNTED = (
    "Counted: what is rounded when {real} is compiled, of samples and inputs that are such numbers, with elementary "
    "functions that err by no more than twice what hgogen measured of them. Not counted: what the way back from z to "
    "the plant's states rounds."
)
_OTHERS = "Not proved: these bounds at other gains, parameters or dt, or while a gain changes."
_AGAIN = (
    "This file was written from the proof itself. `hgogen check` with --certificate writes its evidence, and `hgogen "
    "recheck` says what of it other code verifies."
)
_DERIVED = "The bound of {} follows from the others by outward-rounded intervals, which a certificate does not carry."
_ALONE = "nothing else enters: no other noise, disturbance or error of a parameter, and the plant is the model"


def promised(step: Step) -> list[str]:
    """The lines; none of a step of which it was not asked."""
    known = step.signed
    if known is None:
        return []
    head = "As it runs"
    if not known.bounds:
        return [f"{head}: {_UNPROVED}"]
    lines = [f"{head}, proved: at every call, for ever, {_when(step, known)}"]
    for name, most in known.bounds.items():
        bound = _of(up(_CLOSE * Fraction(most), _DIGITS), _signal(step, name))
        lines.append(f"  |{name} - its estimate| <= {bound}")
    lines += [f"  of {name} nothing within the width of its range;" for name in known.beyond]
    lines += ["  provided that", *(f"    {each};" for each in _assumed(step, known)), f"    {_ALONE}."]
    more = [_DERIVED.format(", ".join(_derived(known)))] * bool(_derived(known))
    rounding = _COUNTED.format(real=known.real) if known.real else _UNCOUNTED
    return [*lines, *(f"  {each}" for each in (*_tuned(step, known), rounding, _OTHERS, _AGAIN, *more))]


def _when(step: Step, known: Signed) -> str:
    if known.settles is None:
        decayed = "once what is left of the error at its start has decayed, for which no time is proved"
        return f"{decayed}: {known.unsettled}"
    after = f"from {up(known.settles, _DIGITS)} {step.time} after the first call on"
    if known.everywhere:
        return f"{after}, wherever in its ranges the plant is then, the estimate where this file starts it"
    most = ", ".join(f"{name} off by {down(most, _DIGITS)}" for name, most in known.begins.items())
    return f"{after}, from an estimate with at most {most} there, which a start alone does not ensure"


def _signal(step: Step, name: str) -> Signal:
    """The state of that name, of the plant or of the form."""
    form = step.observer.form
    names = dict(zip(form.names, form.states, strict=True))
    return {**names, **{signal.name: signal for signal in step.states}}[name]


def _of(value: str, signal: Signal, over: str = "") -> str:
    """A size in the unit of a signal, `over` the unit of time where it is a rate."""
    unit = signal.unit if signal.unit != "1" else ""
    if over:
        return f"{value} ({unit})/{over}" if unit else f"{value}/{over}"
    return f"{value} {unit}" if unit else value


def _assumed(step: Step, known: Signed) -> Iterator[str]:
    read = "samples and the exact inputs" if step.inputs else "samples"
    yield f"a call comes every {pace(step.dt, step.time)}, with the {read} of that time"
    yield "gains and parameters are the nominal ones of this file"
    raised = any(bit.place == Place("status", _USUAL) for bit in step.layout.bits)
    usual = f" but {_USUAL}" * (raised and _USUAL in STEP_BITS)
    yield f"no call since the start or a reset has returned a status bit{usual}"
    system = step.observer.form.system
    signals = (*system.declared.states, *system.inputs, *system.outputs, *system.parameters)
    by_name = {signal.name: signal for signal in signals}
    for kind, each in known.assumed.items():
        yield from (_SAID[kind](step, by_name[name], size) for name, size in each.items())
    yield from _still(step, known.assumed.get("rates", {}))
    clear = [_clear(x, _signal(step, x), most) for x, most in known.inside.items()]
    own = [_range(_signal(step, x)) for x in _derived(known) if _signal(step, x).bounded]
    yield f"at all times the plant keeps to {', '.join([*clear, *own])}"
    if step.inputs:
        yield f"so do its inputs, to {', '.join(map(_range, step.inputs))}"


def _derived(known: Signed) -> list[str]:
    return [x for x in known.bounds if x not in known.inside]


def _clear(name: str, state: Signal, most: float) -> str:
    """A state between the ends of its range, so far clear of them."""
    (low, high), inner = map(Fraction, state.interval), Fraction(most)
    return f"{up(low + inner)} <= {name} <= {down(high - inner)}"


def _range(u: Signal) -> str:
    low, high = u.interval
    return f"{same(low)} <= {u} <= {same(high)}"


def _still(step: Step, rates: Each) -> Iterator[str]:
    """The sentence on inputs that are constant between two calls, or whose motion nothing reads."""
    if step.clock.between == "hold" and step.inputs:
        yield f"between two calls {', '.join(u.name for u in step.inputs)} is held"
        return
    read = set().union(*(sp.sympify(row).free_symbols for row in step.observer.form.flow))
    for u in step.inputs:
        if u.name in rates:
            yield f"between two calls {u} moves on a straight line"
        elif u in read:
            yield f"{u} never moves"


_SAID: Mapping[str, Callable[[Step, Signal, float], str]] = {
    "noise": lambda _, y, size: f"each sample of {y} errs by at most {_of(same(size), y)}, whatever its course",
    "rounded": lambda _, y, size: f"a sample of {y} is rounded to steps of {_of(same(size), y)}",
    "late": lambda step, y, size: f"{y} is sampled within {same(size)} {step.time} of the time of its call",
    "disturbance": lambda step, x, size: f"{x}' is within {_of(same(size), x, step.time)} of what the model says",
    "parameters": lambda _, p, size: (
        f"the plant's {p} is constant and within {_of(same(size), p)} of its declared value"
    ),
    "rates": lambda step, u, size: f"{u} moves by at most {_of(same(size), u, step.time)}",
}


def _tuned(step: Step, known: Signed) -> Iterator[str]:
    """The ranges of theta and dt for which the error decays without noise and disturbances."""
    theta = next(gain.initial[0] for gain in step.layout.gains if gain.name == "theta")
    least = known.least and Fraction(up(known.least, _DIGITS))
    decays = "Without what enters the error decays"
    if least and least < theta:
        yield f"{decays} at every constant theta from {up(known.least or 0, _DIGITS)} to {same(theta)}."
    else:
        yield f"{decays} at theta = {same(theta)}; at any other theta nothing is proved."
    longest = known.longest and Fraction(down(known.longest, _DIGITS))
    if longest and longest > Fraction(step.dt):
        yield f"{decays} at every dt up to {down(known.longest or 0, _DIGITS)} {step.time}, for code generated with it."
