"""Other names of observers: textbook names, each with the observer that it is and the arguments that it fixes.

Q and R of `riccati` are spectral densities. Most filters that are called `ekf` or `kalman` take the noise of one
sample, so that under these names Q and R are accepted only with `density=True`.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import partial, update_wrapper
from inspect import signature
from typing import Any

from hgogen.estimators import discrete
from hgogen.form import Form
from hgogen.observer import Observer, cached_observers
from hgogen.reading.given import BadGain, demand_switch
from hgogen.registry import cases
from hgogen.starting import Gains, Scale, rule, two_digits


@dataclass(frozen=True)
class Synonym:
    """A textbook name of an `observer`, with the arguments that this name fixes, `fixed`; `sentence`: its definition;
    `form`: the form that a plain-text model uses with this name unless it names one; `explicit`: whether the noise must
    be declared either as densities or as that of one sample."""

    observer: str
    fixed: Mapping[str, Any]
    sentence: str
    form: str = "original"
    explicit: bool = False


_TEXTBOOK = {
    "ekf": Synonym("riccati", {"theta": 1.0}, "ekf is riccati at theta = 1, the extended Kalman filter", explicit=True),
    "kalman": Synonym(
        "riccati",
        {"theta": 1.0},
        "kalman is riccati at theta = 1, the Kalman filter of a linear plant, and the extended one of another",
        explicit=True,
    ),
    "luenberger": Synonym(
        "high_gain",
        {"theta": 1.0},
        "luenberger is high_gain at theta = 1, with its poles or gains",
        form="triangular",
    ),
}
# a file of that name is the observer
SYNONYMS = {name: known for name, known in _TEXTBOOK.items() if name not in cases("observers")}


def observer_called(name: str, case_called: Callable[[str], Any]) -> Callable[..., Observer]:
    """Return the observer function with the textbook name `name`; `case_called` returns a function of `hg.observers` by
    its name."""
    known = SYNONYMS[name]
    case = case_called(known.observer)
    function = partial(_make, name, case)
    update_wrapper(function, case)
    parameters = (each for each in signature(case).parameters.values() if each.name not in known.fixed)
    vars(function).update(
        __name__=name,
        __doc__=f"{known.sentence}.",
        __signature__=signature(case).replace(parameters=[*parameters]),
        rule=replace(rule(case), gains=partial(_starting, name, case)),
    )
    return function


def _starting(name: str, case: Callable[..., Observer], numbers: Scale) -> Gains | str:
    """Return the starting gains of the observer `case` without those that the textbook name fixes: poles are multiplied
    by theta, and Q and R declared as densities."""
    gains = rule(case).gains(numbers)
    if isinstance(gains, str):
        return gains
    free = {key: entry for key, entry in gains.items() if key not in SYNONYMS[name].fixed}
    if "poles" in free:
        free["poles"] = _times(gains["theta"], free["poles"])
    return free | {"density": True} if SYNONYMS[name].explicit and not numbers.discrete else free


def _times(theta: float, poles: Any) -> Any:
    return tuple(_times(theta, each) for each in poles) if isinstance(poles, tuple) else two_digits(theta * poles)


_OF_MAPS = cached_observers(discrete.luenberger)


def _make(name: str, case: Callable[..., Observer], form: Any, **arguments: Any) -> Observer:
    known = SYNONYMS[name]
    if repeated := arguments.keys() & known.fixed.keys():
        raise BadGain(f"{name}, {min(repeated)}=", f"is fixed: {known.sentence}; take {known.observer} for another")
    demand_switch("density", arguments.get("density", False))
    densities = [key for key in ("Q", "R", "U") if arguments.get(key) is not None]
    sampled = isinstance(form, Form) and form.system.discrete  # so that there is no density
    if known.explicit and densities and not (sampled or arguments.get("density")):
        reason = (
            f"must say what its {' and '.join(densities)} are: write Q_per_sample, and noise or R_per_sample, if they "
            "are of one sample, or add density = True if they are spectral densities"
        )
        raise BadGain(name, reason)
    if sampled and name == "luenberger":
        if others := arguments.keys() - signature(discrete.luenberger).parameters.keys():
            raise BadGain(f"luenberger, {min(others)}=", "is for differential equations; a discrete plant takes gains")
        return _OF_MAPS(form, **arguments)
    return case(form, **arguments, **known.fixed)
