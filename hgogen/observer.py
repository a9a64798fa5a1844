"""An observer: the estimator's parts as CasADi graphs, with its form, its gains and its paper."""

from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from copy import deepcopy
from dataclasses import dataclass, field, replace
from functools import cache, lru_cache, partial, wraps
from inspect import signature
from typing import Annotated, Any

import numpy as np
import sympy as sp

from hgogen.analysis.dynamics import Dynamics, with_fallback
from hgogen.analysis.linearised import evaluated
from hgogen.analysis.manifold import projected_points
from hgogen.analysis.maps import without_rates
from hgogen.analysis.scaling import exponents
from hgogen.check import Check, ClaimId, Claims, Refuted, Verdict, demand
from hgogen.form import Form
from hgogen.part import Part
from hgogen.program import INF, Block, Field
from hgogen.prove.inclusion import Nothing
from hgogen.reading.given import BadGain, Values, in_order, names, names_of, positive, real, reals, requires
from hgogen.registry import Displayed
from hgogen.rigor.definite import one_thread
from hgogen.sentence import Reason, because
from hgogen.signal import Signal, resting
from hgogen.system import System, demand_continuous
from hgogen.theorem import Convergence, Hypothesis, Theorem, convergence

Initial = Mapping[str, float] | Callable[[Form], Mapping[str, float]]
STARTS = ("initial", "start")  # the arguments of an observer with the start of its estimate
OF_MAPS = ("riccati", "ukf", "iterated_ekf", "luenberger")  # the observers of discrete plants
_CLOSE = "Begin close to the plant, and watch the innovations."
# claims that the error moves by the theorem's equation
_OF_MOTION = ("convergence", "theta", "hold", "attenuation", "quadratic")
_LAST = 32  # calls of each case whose observers are remembered


def age_of(name: str) -> str:
    """Return NAME_age, the name of the signal that gives the age of a late sample of the output NAME. A final "_" of
    NAME is dropped, since C++ reserves "__"."""
    return f"{name.rstrip('_')}_age"


@dataclass(frozen=True, eq=False, repr=False)
class Observer(Displayed):
    """An estimator on a form.

    `parts`: in the order in which they run; `gains`: tunable, at places `gain.NAME`; `z`: SX (n) of the form's state
    from places of the state, whose image under the form's `from_form` is the estimate; `traces`: scalar fields of the
    state for logs; `notices`: blocks that raise bits of the status at the end of a call; `claims`: a function that
    proves its checks, those of the form and of the theorem; `accepted`: ids of refuted checks that the user accepts;
    `theorem`: its conclusion and hypotheses; `equations`: lines for the banner; `reference`: the paper; `practical`:
    the error does not tend to 0, so that an estimate may stay outside the ranges of a state at their edge; `delays`:
    the largest number of samples by which an output may come late, for the outputs that do; `error`: for a constant
    injection, the inclusion of its error (`prove.inclusion`), or `Nothing`; `construction`: the case of `hg.observers`
    and its arguments; `at_period`: for noise that is declared for one sample, the function from the periods (dt, *T) of
    a step and of the outputs' samples (p), and the dt of the process noise, to the observer with densities; `periods`:
    those for which its densities are, () for none; `process_dt`: the dt to which process noise of a sample belongs, 0
    for the next one.
    """

    form: Form
    name: Annotated[str, "name of the observer"]
    parts: tuple[Part, ...]
    gains: tuple[Field, ...]
    z: Any  # a Graph, which mypy would take for a Sparsity in ca.vertcat
    dynamics: Dynamics
    claims: Callable[[], tuple[Check, ...]]
    accepted: tuple[str, ...]
    theorem: Theorem
    equations: tuple[str, ...]
    reference: str
    practical: bool = False
    traces: tuple[str, ...] = ()
    notices: tuple[Block, ...] = ()
    delays: tuple[tuple[str, int], ...] = ()
    error: Any | None = None
    construction: "partial[Observer] | None" = None
    at_period: "Callable[[Sequence[float], float], Observer] | None" = None
    periods: tuple[float, ...] = ()
    process_dt: float = 0.0

    def __post_init__(self) -> None:
        object.__setattr__(self, "claims", cache(partial(_claimed, self.claims)))

    @property
    def checks(self) -> tuple[Check, ...]:
        """The checks of the form and of the theorem, proved when first read, which may take longer than building."""
        return self.claims()

    @property
    def convergence(self) -> Convergence | None:
        """The status of its convergence; None if no theorem covers it, as of most observers in the plant's own
        coordinates."""
        known = convergence(self.name, self.checks)
        return None if known is Convergence.UNKNOWN and self.form.kind == "original" else known

    @property
    def ages(self) -> tuple[Signal, ...]:
        """The signals that give the age of a sample, one for each output in `delays`."""
        meaning = "periods ago in which {} was taken, a whole number"
        return tuple(
            Signal(age_of(name), "", meaning.format(name), nominal=0, low=0, high=most) for name, most in self.delays
        )

    def started(self, initial: Initial) -> "Observer":
        """Return the observer rebuilt with the start `initial`, also of a member in it: the plant's state by name, or a
        function of the form that returns it.

        Raises: `BadGain` for a start that its form does not accept, or for an observer that is not from `hg.observers`.
        """
        make, base, gains = self._making
        if isinstance(base, Observer):
            return make(base.started(initial), **gains)
        others = {name: value for name, value in gains.items() if name not in STARTS}
        return make(base, **others, initial=initial(base) if callable(initial) else initial)

    @property
    def initial(self) -> dict[str, float]:
        """The argument `initial` of the observer, or of the single observer in a bank: the plant's state by name; empty
        without one. Raises: `BadGain` for an observer that is not from `hg.observers`."""
        _, base, gains = self._making
        if isinstance(base, Observer):
            return base.initial
        initial = gains.get("initial") or {}
        names = [signal.name for signal, _ in base.estimates]
        return dict(initial if isinstance(initial, Mapping) else zip(names, initial, strict=True))

    def on(self, form: Callable[[System], Form]) -> "Observer":
        """Return the observer rebuilt on the form `form(plant)` of its plant; of a bank, the single observers are
        rebuilt. Raises: as the observer does for that form; `BadGain` for an observer that is not from
        `hg.observers`."""
        make, base, gains = self._making
        if isinstance(base, Observer):
            return make(base.on(form), **gains)
        return make(form(without_rates(base.system.declared)), **gains)

    def clamping(self, clamped: bool) -> "Observer":
        """Return the observer with the arguments of b and h clamped to their ranges (True), or with its equations as
        they are written (False); unclamped it has no claims except those of the form.

        Raises: `BadGain` for an observer that is not from `hg.observers`, or for a bank.
        """
        make, base, gains = self._making
        if isinstance(base, Observer):
            raise BadGain(self.name, "restarts and selects members by what guards it; sample a member of it alone")
        observer = make(replace(base, clamped=clamped), **gains)
        return observer if clamped else replace(observer, claims=lambda: base.checks)

    def sampled(self, dt: float, periods: Sequence[float]) -> "Observer":
        """Return the observer with its noise as densities, for noise that is declared for one sample: at the period
        `dt` of a step and the `periods` (p) of the outputs' samples. Raises: `BadGain`."""
        periods = (dt, *periods)
        return self if self.at_period is None or self.periods == periods else _sampled(self, periods)

    @property
    def arguments(self) -> Mapping[str, Any]:
        """The keyword arguments of the observer's function; empty for an observer that is not from `hg.observers`."""
        return self.construction.keywords if self.construction else {}

    @property
    def _making(self) -> "tuple[Callable[..., Observer], Any, dict[str, Any]]":
        if self.construction is None:
            raise BadGain(self.name, "was not made by hg.observers, so that nobody knows how to make it again")
        case, args, keywords = self.construction.func, self.construction.args, self.construction.keywords
        arguments = signature(case).bind(*args, **keywords).arguments
        (_, base), *gains = arguments.items()
        return partial(_remade, case, self.process_dt), base, dict(gains)

    def __repr__(self) -> str:
        return f"<{self.name} observer of {self.form.system.name} in {self.form.kind} form>"

    def __reduce__(self) -> tuple[Any, ...]:
        """Return the call that rebuilds the observer, since a pickle holds no graphs. Raises: `BadGain` for an observer
        that is not from `hg.observers`."""
        if self.construction is None:
            raise BadGain(self.name, "was not made by hg.observers, so that nobody knows how to make it again")
        call = self.construction
        return _again, (call.func, call.args, call.keywords, self.form.clamped, self.process_dt)

    def __copy__(self) -> "Observer":
        return self

    def __deepcopy__(self, memo: Any) -> "Observer":
        return self


asks_an_observer = requires(Observer, "an observer, one of hg.observers; that of a step is step.observer")


@lru_cache(maxsize=_LAST)
def _sampled(observer: Observer, periods: tuple[float, ...]) -> Observer:
    make, base, gains = observer._making
    dt, *others = periods
    process_dt = observer.process_dt or dt
    if isinstance(base, Observer):
        built = make(replace(base, process_dt=process_dt).sampled(dt, others), **gains)
    else:
        assert observer.at_period is not None
        built = observer.at_period(periods, process_dt)
    built = replace(
        built,
        construction=observer.construction,
        at_period=observer.at_period,
        periods=periods,
        process_dt=process_dt,
    )
    return built if observer.form.clamped else replace(built, claims=lambda: observer.form.checks)


def _claimed(claims: Callable[[], tuple[Check, ...]]) -> tuple[Check, ...]:
    with one_thread():
        return claims()


def _remade(case: Callable[..., Observer], process_dt: float, *args: Any, **keywords: Any) -> Observer:
    observer = cached_observers(case)(*args, **keywords)
    return replace(observer, process_dt=process_dt) if process_dt else observer


def _again(
    make: Callable[..., Observer],
    args: tuple[Any, ...],
    keywords: Mapping[str, Any],
    clamped: bool,
    process_dt: float = 0.0,
) -> Observer:
    observer = _remade(make, process_dt, *args, **keywords)
    return observer if clamped else observer.clamping(False)  # without the claims of the theorem


def cached_observers(make: Callable[..., Observer]) -> Callable[..., Observer]:
    """Return the observer function `make` with a cache: equal arguments on the same form return the same observer, for
    the most recent calls. Each observer holds its arguments in `construction`. An observer never changes, nor do the
    cached arguments."""

    def new(call: _Call) -> Observer:
        accepted = names("accept", call.keywords.get("accept", ()))
        args = (with_fallback(each, accepted) if isinstance(each, Form) else each for each in call.args)
        keywords = {k: with_fallback(v, accepted) if isinstance(v, Form) else v for k, v in call.keywords.items()}
        with one_thread():
            observer = make(*args, **keywords)
        return replace(_on_invariants(_up_to_turns(observer)), construction=partial(make, *call.args, **call.keywords))

    last = lru_cache(maxsize=_LAST)(new)

    @wraps(make)
    def make_cached(*every: Any, **named: Any) -> Observer:
        args, keywords = tuple(map(_frozen, every)), _frozen(named)
        call = _Call((_comparable(args), _comparable(keywords)), args, keywords)
        try:
            hash(call)
        except TypeError:
            return new(call)
        return last(call)

    return make_cached


def _up_to_turns(observer: Observer) -> Observer:
    """Return the observer with weaker claims if an output is periodic: a proof whose injection assumes output errors
    below half a turn becomes unknown, unless the check `NAME.region` proves a region of initial errors where they
    are."""
    turning = [y.name for y in observer.form.system.outputs if y.period is not None]
    if not turning:
        return observer
    id, below = ClaimId(observer.name, "region"), f"the error of {' and '.join(turning)} stays below half a turn"
    unproved = because("it is not proved that {below}", below=below)
    unknown = Check(id, below, Verdict.UNKNOWN, because("no proof is made of this observer"), fix=_CLOSE)

    def known() -> tuple[Check, ...]:
        checks = observer.checks
        if any(check.id == id for check in checks):
            return checks
        return *_unproved(observer, _OF_MOTION, unproved), unknown

    hypothesis = Hypothesis("the errors of periodic outputs stay below half a turn", (Claims(observer.name, "region"),))
    error = observer.error and Nothing(because("the proof is not made for the samples of periodic outputs"))
    start = ", ".join(filter(None, (f"from the initial errors of {id}", observer.form.system.modulo)))
    return replace(observer, claims=known, theorem=observer.theorem.under(hypothesis, start=start), error=error)


def _on_invariants(observer: Observer) -> Observer:
    """Return the observer with weaker claims if its estimate is projected onto the plant's invariants: claims about the
    motion of the error become unknown, since the projection could increase the error in the norm of a proof."""
    if not observer.form.system.invariants:
        return observer
    smaller = "the projection onto the plant's invariants increases no error"
    why = because("it is not proved that {smaller}", smaller=smaller)
    hypothesis = Hypothesis(smaller, verdict=Verdict.UNKNOWN, reason="try it on trials that are like the plant")
    return replace(
        observer,
        claims=lambda: _unproved(observer, (*_OF_MOTION, "region"), why),
        theorem=observer.theorem.under(hypothesis),
        error=observer.error and Nothing(why),
    )


def _unproved(observer: Observer, facts: Collection[str], why: Reason) -> tuple[Check, ...]:
    """Return the checks of an observer, those of its own `facts` that are proved set to unknown for the reason
    `why`."""
    own = {ClaimId(observer.name, fact) for fact in facts}
    return tuple(
        replace(check, verdict=Verdict.UNKNOWN, reason=why, proofs=())
        if check.id in own and (check.proofs or check.verdict is Verdict.PROVED)
        else check
        for check in observer.checks
    )


@dataclass(frozen=True)
class _Call:
    comparable: Any
    args: tuple[Any, ...] = field(compare=False)
    keywords: Mapping[str, Any] = field(compare=False)


def _frozen(value: Any) -> Any:
    match value:
        case Form():
            return value
        case Mapping():
            return {name: _frozen(entry) for name, entry in value.items()}
        case Iterator():
            return tuple(value)
    try:
        hash(value)
    except TypeError:
        return deepcopy(value)
    return value


def _comparable(value: Any) -> Any:
    """Return a hashable key that is equal for equal arguments; numbers of different types differ, and a form equals
    itself only."""
    match value:
        case Form():
            return id(value)  # the form lives as long as the observer
        case Mapping():
            return "mapping", tuple((name, _comparable(entry)) for name, entry in value.items())
        case list() | tuple():
            return type(value), tuple(map(_comparable, value))
        case np.ndarray() if not isinstance(value, np.ma.MaskedArray):
            return value.shape, value.dtype.str, value.tobytes()
        case bool() | int() | float() | np.generic():
            return type(value), repr(value)
    return value


def demand_form(
    name: str,
    form: Any,
    accept: Iterable[str],
    *,
    deferred: Iterable[ClaimId] = (),
    requires: Callable[[str, Form], Any] | None = None,
    linearises: bool = False,
    discrete: bool = False,
) -> tuple[str, ...]:
    """Return `accept` as a tuple, after the checks that every observer needs: `form` is a `Form`, without refuted
    hypotheses other than those in `accept`.

    `deferred`: refutable claims of the observer, which it demands later; `requires`: a function that raises `BadGain`
    for a form to which the observer does not apply, so that accepting a claim cannot help; `linearises`: whether the
    observer evaluates the Jacobian at its estimate, so that the checks of `evaluated` are demanded; `discrete`: whether
    there is such an observer of a discrete plant.

    Raises: `BadGain`, `DiscretePlant`, `Refuted`, `UnknownCheck`.
    """
    if not isinstance(form, Form):
        raise BadGain(name, f"takes a form, such as hg.forms.triangular(plant), not a {type(form).__name__}")
    if not discrete:
        demand_continuous(form.system, name, f"; take {', '.join(OF_MAPS[:-1])} or {OF_MAPS[-1]}")
    accept = names("accept", accept)
    slopes = evaluated(form) if linearises or accept else ()
    tested = replace(form, checks=(*form.checks, *slopes)) if linearises and slopes else form
    unclamped = evaluated(replace(form, clamped=False)) if accept else ()  # the checks of a step without guards
    try:
        demand(tested.checks, accept, tested, (*deferred, *(check.id for check in (*slopes, *unclamped))))
    except Refuted as error:
        raise replace(error, never=_never(name, form, requires, error.checks)) from None
    return accept


def _never(name: str, form: Form, requires: Callable[[str, Form], Any] | None, known: Collection[Check | None]) -> str:
    try:
        if requires is not None:
            requires(name, form)
    except BadGain as error:
        return f"To accept it does not help: {replace(error, because=None) if error.because in known else error}."
    return ""


def state_field(form: Form, initial: Values | None, peak: float) -> Field:
    """Return the field `z` (n) of an estimate in the form's coordinates, with its initial value and its outer box.

    The outer box has the centre of the declared box, and a half-width larger by peak^(i-1) for state i, by which a
    high-gain observer overshoots (with several chains, peak to the power of theta in Delta^-1), and at least by 3.
    `initial`: the plant's states, by name or in order; a state without a value there starts at its nominal value, else
    at 0 or the end of its range nearest to 0; an angle may be off by some turns. It may also name inputs, at which z(x,
    u) is then evaluated in place of their resting values; where z depends on u, the estimate is x for these inputs
    only.

    Raises: `BadNames`; `BadGain` for an initial state of the wrong length, not finite, or outside its range.
    """
    start, inputs = _initial(form, initial)
    values = [float(e.subs({**form.system.nominal, **inputs}).subs(start)) for e in map(sp.sympify, form.to_form)]
    low, high = [], []
    for signal, exponent in zip(form.states, exponents(form), strict=True):
        bottom, top = signal.interval
        # through the inverse each state may overshoot as the last
        power = exponent if form.jacobian is None else form.n - 1
        centre, half = (bottom + top) / 2, (top - bottom) / 2 * max(3.0, peak**power)
        half = half if signal.period is None else (top - bottom) / 2
        low.append(centre - half if signal.bounded else -INF)
        high.append(centre + half if signal.bounded else INF)
    labels = tuple(str(expression) for expression in form.to_form)
    return Field(
        "z",
        tuple(values),
        low=tuple(low),
        high=tuple(high),
        outer=True,
        labels=labels,
        periods=tuple(signal.period for signal in form.states) if any(s.period for s in form.states) else (),
        meaning="estimate in the form's coordinates",
    )


def _initial(form: Form, initial: Values | None) -> tuple[dict[Signal, float], dict[Signal, float]]:
    origin, inputs = form.system.origin, form.system.inputs
    states = form.system.declared.states
    defaults = {s.name: resting(s) for s in (*states, *inputs)}
    if initial is None or isinstance(initial, Mapping):
        ordered = in_order("initial", initial or {}, tuple(defaults), default=defaults)
        values = [real(f"initial {name}", value) for name, value in zip(defaults, ordered, strict=True)]
    else:
        values = [*reals("initial", initial).reshape(-1), *map(resting, inputs)]
    if len(values) != len(defaults):
        wanted = f"must have one number for each of {', '.join(names_of(states))}"
        raise BadGain(f"initial of length {len(values) - len(inputs)}", wanted)
    initial_values = dict(zip((*states, *inputs), map(float, values), strict=True))
    start, now = ({s: initial_values[s] for s in signals} for signals in (states, inputs))
    for signal, value in start.items():
        low, high = signal.limits
        if not (np.isfinite(value) and low <= value <= high):
            raise BadGain(f"initial {signal.name} = {value}", f"must be finite and in [{low:g}, {high:g}]")
        start[signal] = float(signal.turned(value))
    plant = form.system.declared
    projected = projected_points(plant.invariants, states, plant.nominal, np.array([list(start.values())]))
    start = dict(zip(states, map(float, projected[0]), strict=True)) if len(projected) else start
    if origin is None:
        return start, now
    numbers = start | form.system.nominal
    recast = {s: float(e.subs(numbers)) for s, e in zip(form.system.states, origin.forward, strict=True)}
    return recast, now


def gain(name: str, value: Iterable[float] | float, low: float, high: float, meaning: str, unit: str = "") -> Field:
    """Return the field of place `gain.NAME` of a tunable gain, scalar or array, with one range for all its elements.
    Raises: `BadGain` for a value that is not finite or lies outside the range."""
    values = (float(value),) if isinstance(value, int | float) else tuple(float(v) for v in value)
    for element in values:
        if not np.isfinite(element) or not low <= element <= high:
            raise BadGain(f"{name} = {element:g}", f"must be a finite number in [{low:g}, {high:g}]: {meaning}")
    size = len(values)
    return Field(name, values, low=(low,) * size, high=(high,) * size, unit=unit, meaning=meaning)


def high_gain_parameter(theta: Any) -> Field:
    """Return the field of the gain `theta`, tunable from 1 to the given value, at which step lengths are computed.
    Raises: `BadGain` for theta < 1 or not finite."""
    value = real("theta", theta)
    if not 1 <= value < np.inf:
        raise BadGain(f"theta = {value!r}", "must be a finite number, at least 1")
    return gain("theta", value, 1.0, value, "high-gain parameter")


def positive_theta(theta: Any) -> Field:
    """Return the field of the gain `theta` > 0 of an observer with a constant gain matrix. A theta below 1, which the
    theorem excludes, cannot be tuned. Raises: `BadGain`."""
    value = positive("theta", theta)
    return high_gain_parameter(value) if value >= 1 else gain("theta", value, value, value, "high-gain parameter")


def parameter_fields(parameters: Iterable[Signal]) -> tuple[Field, ...]:
    """Return a field at the place `plant.NAME` for each parameter of the plant with a range."""
    return tuple(
        Field(s.name, (float(s.nominal or 0),), low=(low,), high=(high,), unit=s.unit, meaning=s.meaning)
        for s in parameters
        if s.bounded
        for low, high in (s.interval,)
    )
