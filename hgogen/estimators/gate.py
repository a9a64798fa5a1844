"""Innovation gates: which samples a filter rejects because they are too far from its prediction.

    r = y - h(z),  S = H P H' + R     of the finite samples of a group, at the prediction, before any sample is used
    d = r' S^-1 r                     accepted if d <= gamma, the chi-square quantile of the gate's probability with as
                                      many degrees of freedom as there are finite samples in the group

A rejected sample counts as missing. With `inflate`, it corrects with the noise R_jj + (d/gamma - 1) S_jj instead; for
one output its innovation is then at the gate. After `accept_after` samples in a row beyond the gate, the next one is
accepted: the variances of the states that its outputs read are raised, until H P H' >= r_j^2 or to their caps, and
their covariances with all other states are set to 0. So hidden states keep their estimates. Source: Bar-Shalom, Li,
Kirubarajan, "Estimation with Applications to Tracking and Navigation" (2001), section 5.4; the raised noise, Chang,
"Robust Kalman filtering based on Mahalanobis distance as outlier judging criterion", Journal of Geodesy 88 (2014).
"""

from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass, fields, replace
from functools import cached_property, lru_cache
from math import nextafter
from typing import Any, TypeAlias

from flint import arb, ctx

from hgogen.check import Check, ClaimId, Verdict
from hgogen.observer import Observer
from hgogen.program import Bit
from hgogen.reading.given import BadGain, count, names_of, real
from hgogen.sentence import because
from hgogen.signal import Signal
from hgogen.theorem import Hypothesis

Gates: TypeAlias = Mapping[str | tuple[str, ...], "float | Gate | Mapping[str, Any]"]  # by outputs
LEAST, MOST = 0.5, 1 - 1e-12  # of a probability
LONGEST = 10_000  # samples in a row
PRECISION = 128  # binary digits of a quantile's distribution function


@dataclass(frozen=True)
class Gate:
    """A gate of the innovations of one or several outputs.

    `probability`: of an innovation of the model to pass, from 0.5 to 1 - 1e-12; `accept_after`: samples in a row beyond
    the gate after which the next one is accepted (1 to 10000); `inflate`: whether a sample beyond the gate corrects
    with a larger R, instead of being rejected. Raises: `BadGain`.
    """

    probability: float
    accept_after: int = 10
    inflate: bool = False

    def __post_init__(self) -> None:
        if not LEAST <= real("the probability of a gate", self.probability) <= MOST:
            wanted = f"must be a probability from {LEAST:g} to 1 - {1 - MOST:.0e}, such as 0.999"
            raise BadGain(f"the gate {self.probability!r}", wanted)
        count("accept_after", self.accept_after, 1, LONGEST)
        if not isinstance(self.inflate, bool):
            raise BadGain(f"inflate = {self.inflate!r}", "must be true or false")


@dataclass(frozen=True)
class GatedGroup:
    """The outputs, by index and by name, whose samples the `gate` accepts or rejects together."""

    outputs: tuple[int, ...]
    names: tuple[str, ...]
    gate: Gate

    @property
    def name(self) -> str:
        """The name of the group in status bits and in memory."""
        return "_".join(self.names)

    @property
    def expected(self) -> float:
        """The fraction of samples that the gate rejects if the model, Q and R are right."""
        return round(1 - self.gate.probability, 15)

    @property
    def entry(self) -> tuple[str, float | dict[str, Any]]:
        """The key and the value of the gate in a model file: the outputs as one text, and the probability of the gate,
        or a table of its arguments."""
        plain = self.gate == Gate(self.gate.probability)
        return ", ".join(self.names), self.gate.probability if plain else asdict(self.gate)

    @cached_property
    def limits(self) -> tuple[float, ...]:
        """The largest d that passes, for 1, 2, .. finite samples."""
        return tuple(quantile(self.gate.probability, k + 1) for k in range(len(self.outputs)))

    @property
    def outside(self) -> Bit:
        """The status bit of samples beyond the gate."""
        beyond = f"{' and '.join(self.names)}: innovation beyond the gate of probability {self.gate.probability:g}"
        if self.gate.inflate:
            return Bit(f"INFLATED_{self.name}", f"{beyond}, corrected with a larger R", _WATCH)
        return Bit(f"GATED_{self.name}", f"{beyond}, predicted only", _WATCH)

    @property
    def reacquired(self) -> Bit:
        """The status bit of samples that are accepted after too many in a row beyond the gate."""
        meaning = (
            f"{' and '.join(self.names)}: beyond the gate for {self.gate.accept_after} samples in a row, so that this "
            "one was accepted: the variances of the states that it measures were raised, their covariances cleared"
        )
        return Bit(
            f"REACQUIRED_{self.name}", meaning, "treat these states as new; if it repeats, check Q, R and sensor"
        )

    @property
    def equation(self) -> str:
        """The line of the banner about this gate."""
        limits = ", ".join(f"{limit:.6g}" for limit in self.limits)
        return (
            f"gate of {', '.join(self.names)}: r' S^-1 r <= {limits}, r = y - h, S = H P H' + R at the prediction; "
            f"beyond it {'a larger R' if self.gate.inflate else 'no correction'}, {self.gate.accept_after} times in a "
            "row at most"
        )


_WATCH = "none if rare; if it stays, check the sensor, or raise Q and R"


@lru_cache(maxsize=64)
def quantile(probability: float, degrees: int) -> float:
    """Return the chi-square quantile x, P(chi^2 <= x) = `probability`, of so many degrees of freedom: the largest
    double below it."""
    with ctx.workprec(PRECISION):

        def below(x: float) -> bool:
            return bool((arb(x) / 2).gamma_lower(arb(degrees) / 2, regularized=1) < arb(probability))

        low, high = 0.0, 1.0
        while below(high):
            low, high = high, 2 * high
        while nextafter(low, high) < high:
            middle = low + (high - low) / 2
            low, high = (middle, high) if below(middle) else (low, middle)
    return low


def gated_groups(declared: Any, outputs: Iterable[Signal]) -> tuple[GatedGroup, ...]:
    """Return the gated groups of outputs that `declared` maps to their gates. A key is one output or several, as a
    tuple or in one text "px, py"; a value is a probability, a `Gate`, or a table of its arguments. Raises:
    `BadGain`."""
    if declared is None:
        return ()
    if not isinstance(declared, Mapping):
        raise BadGain(f"gate = {declared!r}", 'must name outputs with their probabilities, such as {"y": 0.999}')
    names = names_of(outputs)
    groups, used = [], set[str]()
    for key, value in declared.items():
        listed = key if isinstance(key, tuple) else str(key).split(",")
        named = [str(each).strip() for each in listed]
        for name in named:
            if name not in names:
                raise BadGain(f"gate of {name!r}", f"names no output; the outputs are {', '.join(names)}")
            if name in used:
                raise BadGain(f"gate of {name!r}", "names this output twice; give each output one gate")
            used.add(name)
        if not named:
            raise BadGain("a gate of no output", f"must name one of the outputs {', '.join(names)}, or several")
        indices = tuple(sorted(names.index(name) for name in named))
        groups.append(GatedGroup(indices, tuple(names[j] for j in indices), _gate(value)))
    if len({group.name for group in groups}) < len(groups):
        raise BadGain("gate", "has two groups of the same name; rename an output")
    return tuple(groups)


def _gate(value: Any) -> Gate:
    if isinstance(value, Gate):
        return value
    if not isinstance(value, Mapping):
        return Gate(value)
    known = [field.name for field in fields(Gate)]
    for name in value:
        if name not in known:
            raise BadGain(f"{name!r} of a gate", f"is no argument; these are {', '.join(known)}")
    if "probability" not in value:
        raise BadGain(f"the gate {dict(value)}", "has no probability; give one, such as 0.999")
    return Gate(**value)


_REJECTS = Hypothesis(
    "no sample of the plant is rejected by a gate for long",
    verdict=Verdict.UNKNOWN,
    reason="a gate decides by the estimated covariance, which nothing here bounds; watch the status",
)


def with_gates(observer: Observer, groups: tuple[GatedGroup, ...]) -> Observer:
    """Return the observer without its claim of convergence if it has gates: how often they reject is not proved."""
    if not groups:
        return observer
    why = because("how often the gates reject samples is not proved, and a rejected sample corrects nothing")
    own = ClaimId(observer.name, "convergence")

    def claims() -> tuple[Check, ...]:
        return tuple(
            replace(check, verdict=Verdict.UNKNOWN, reason=why, proofs=())
            if check.id == own and check.verdict is Verdict.PROVED
            else check
            for check in observer.checks
        )

    return replace(observer, claims=claims, theorem=observer.theorem.under(_REJECTS))
