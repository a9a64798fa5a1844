"""What a fit found, and what it is worth."""

import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Annotated, Any, Literal

import numpy as np

from hgogen.analysis.observability import observability
from hgogen.logs.solution import Solution
from hgogen.rigor.rank import NothingMeasured, NowhereDefined
from hgogen.rigor.tape import NoTape
from hgogen.run.consistency import Whiteness
from hgogen.sentence import Encoded
from hgogen.signal import Signal
from hgogen.system import System

Array = np.ndarray
Place = Literal["", "low", "high"]
FINE = 1e-4  # of the spread of an output: smaller residuals are those of the method
SAME = 1e-2  # of the cost, or of its logarithm where it is one, by which starts may differ that ended at one minimum
_COLOURED = {
    "simulation": "the plant does more than the model, or the noise is slow, as that of a coarse encoder; where noise "
    "moves the plant, --by prediction (by=) fits it along",
    "prediction": "they can be predicted, so that the model, or the time of an input or sensor, is off",
}
_UNSETTLED = {
    "simulation": "narrower ranges, or, of a plant that is unstable or that noise moves, --by prediction",
    "prediction": "or narrower ranges",
}
NONE = 1e-6  # of a direction: less of it is rounding


@dataclass(frozen=True)
class Structure:
    """What outputs tell of parameters, lags and offsets."""

    rank: Annotated[int, "how many sums of them the outputs tell at most"]
    count: Annotated[int, "number of parameters, lags and offsets"]
    hidden: Annotated[tuple[str, ...], "those that are proved not to be told by themselves"]
    doubtful: Annotated[tuple[str, ...], "those of which that is not known"]
    unseen: Annotated[tuple[str, ...], "what hides them, in words"]
    repairs: Annotated[tuple[str, ...], "states and parameters, of which measuring one as well would show all"]


@dataclass(frozen=True)
class Estimate:
    """A parameter, or the offset of an output: its `value`, the `nominal` one that it had, its standard error
    `deviation`, infinite where the records do not tell it or it is held at an end, its `unit`; `at` the "low" or "high"
    end of its range, "" within."""

    name: str
    value: float
    nominal: float
    deviation: float
    unit: str
    at: Place


@dataclass(frozen=True)
class SearchEnd:
    """How a search ended."""

    cost: Annotated[float, "cost without the pull"]
    status: Annotated[str, "how IPOPT ended"]
    iterations: Annotated[int, "number of iterations"]


def _by_name(each: Iterable[Estimate], what: str) -> dict[str, Any]:
    return {one.name: getattr(one, what) for one in each}


@dataclass(frozen=True, eq=False)
class Fit(Encoded):
    """What `fit` found.

    `plant`: with the fitted values; `parameters`, `offsets` and `lags` of outputs: their estimates; `fitted`: the
    outputs (N, p) of each record, NaN where nothing was measured; `starts`: how each ended, of a robust fit its last
    pass; `noise`: by prediction, the density of process noise by state, next to nothing of one whose rate is by
    definition another state, and the deviation of a sample by output: Q, and R over the period, of a `riccati` on the
    plant's own coordinates.
    """

    json_keys = (
        "by parameters=values deviation nominal at_end lags=lag_values offsets=offset_values first error spread "
        "unfitted alike untold joint confined outlying whiteness rivals noise=levels starts=ends"
    )

    by: Annotated[str, "the error that is least, of which the residuals are: simulation or prediction"]
    plant: System
    parameters: tuple[Estimate, ...]
    lags: tuple[Estimate, ...]
    offsets: tuple[Estimate, ...]
    first: Annotated[tuple[dict[str, float], ...], "the state of each record at its first sample"]
    fitted: tuple[Array, ...]
    error: Annotated[dict[str, float], "RMS of each output's residual, in its unit"]
    spread: Annotated[dict[str, float], "RMS of each output about its mean"]
    unfitted: Annotated[dict[str, float], "RMS residual of the plant as it was given, its states fitted alone"]
    alike: Annotated[dict[str, float], "by output, how many residuals tell as much as one that is independent"]
    untold: Annotated[tuple[dict[str, float], ...], "directions that the records do not tell, in units of ranges"]
    joint: Annotated[Structure | None, "what no record tells; null where the records tell all"]
    confined: Annotated[tuple[str, ...], "the states that lie at an end of their range"]
    starts: tuple[Solution, ...]
    outlying: Annotated[dict[str, float], "by output, the share of residuals beyond 5 robust deviations"]
    whiteness: Annotated[dict[str, Whiteness | None], "test of each output's residuals, of innovations over deviations"]
    rivals: Annotated[tuple[dict[str, float], ...], "estimates of starts that ended elsewhere at the same cost"]
    noise: tuple[dict[str, float], dict[str, float]]

    @property
    def values(self) -> dict[str, float]:
        """Fitted values of parameters by name."""
        return _by_name(self.parameters, "value")

    @property
    def deviation(self) -> dict[str, float]:
        """Standard errors of parameters, infinite (null) where the records do not tell."""
        return _by_name(self.parameters, "deviation")

    @property
    def nominal(self) -> dict[str, float]:
        """Values of parameters before the fit."""
        return _by_name(self.parameters, "nominal")

    @property
    def at_end(self) -> dict[str, Place]:
        """The end of its range, low or high, at which a parameter lies."""
        return _by_name([one for one in self.parameters if one.at], "at")

    @property
    def lag_values(self) -> dict[str, float]:
        """Time constants of the lags of outputs."""
        return _by_name(self.lags, "value")

    @property
    def offset_values(self) -> dict[str, float]:
        """Offsets of outputs."""
        return _by_name(self.offsets, "value")

    @property
    def levels(self) -> dict[str, dict[str, float]]:
        """Noise by prediction: process, the density by state, and sample, the deviation by output."""
        return dict(zip(("process", "sample"), self.noise, strict=True))

    @property
    def ends(self) -> tuple[SearchEnd, ...]:
        """How each start ended."""
        return tuple(SearchEnd(one.cost, one.status, one.iterations) for one in self.starts)

    def notes(self) -> tuple[str, ...]:
        """What the result is worth, a sentence each."""
        ranged = {p.name: p.bounded for p in self.plant.parameters}
        lines = []
        for one in self.parameters:
            if one.at and ranged[one.name]:
                lines.append(f"{one.name} lies at the {one.at} end of its range; widen it, or leave {one.name} out")
            elif one.at:
                doubt = "its sign, or that of a column, or a unit may be wrong"
                lines.append(f"{one.name} went as far from {one.nominal:g} as it may without a range; {doubt}")
        for one in self.lags:
            if one.at == "low":
                lines.append(f"the records show no lag of {one.name} of half a sample or more")
            elif math.isfinite(one.deviation):
                state = f"a state {one.name}_behind' = (output - {one.name}_behind)/{one.value:.3g}"
                lines.append(f"the sensor of {one.name} lags, which the model does not say: give it {state} as output")
        lines += [
            f"{name} lies at an end of its range somewhere; if it may be beyond, widen it" for name in self.confined
        ]
        lines += [self._not_told(parts) for parts in self.untold]
        lines += [line for name in self.alike for line in self._followed(name)]
        for name, part in self.outlying.items():
            if part and self.error[name] > FINE * self.spread[name]:
                lines.append(f"{part:.2g} of the residuals of {name} lie beyond 5 times their typical size")
        return (*lines, *self._searched())

    def _not_told(self, parts: Mapping[str, float]) -> str:
        """Of a direction of parameters, whether another record would tell it, as far as that is known."""
        total = " ".join(f"{part:+.2g} {name}" for name, part in parts.items())
        what = f"tell {total}, in units of ranges: where it ended says nothing"
        fix = "fix one of them" if len(parts) > 1 else "fix it"
        joint, hidden = self.joint, set(self.joint.hidden if self.joint else ())
        doubtful = hidden.union(self.joint.doubtful if self.joint else ())
        inside = [set(each) <= hidden for each in self.untold]
        if joint is not None and set(parts) <= hidden and sum(inside) <= joint.count - joint.rank:
            measured = " or ".join(name for name in joint.repairs if name not in parts)
            more = f", or measure {measured} as well" if measured else ""
            return f"no record of these outputs would {what}; {fix}{more}"
        if set(parts) & doubtful:
            unknown = f"the records do not {what}, and whether another record would is not known"
            return f"{unknown}; {fix}, or move the plant more"
        others = ", though others would," if joint is not None else ""
        more = "" if len(parts) > 1 and not others else ", or move the plant more"
        return f"the records do not{others} {what}; {fix}{more}"

    def _followed(self, name: str) -> Iterator[str]:
        if not self.spread[name]:
            yield f"{name} stands still in the records, so that it tells little; give a record in which the plant moves"
        if self.error[name] >= self.spread[name] > 0:
            yield f"{name} is followed no better than by its mean; are its unit, sign and offset right?"
        test, tau = self.whiteness[name], self.alike[name]
        if test is None or test.white or self.error[name] <= FINE * self.spread[name]:
            return
        what = "residuals" if self.by == "simulation" else "innovations"
        count = f", {tau:.3g} of them tell as much as one, which the standard errors count" if tau > 1.05 else ""
        limits = f"Ljung-Box {test.statistic:.3g}, limit {test.limit:.3g}"
        yield f"{what} of {name} are not white ({limits}){count}: {_COLOURED[self.by]}"

    def _searched(self) -> Iterator[str]:
        best = min(one.cost for one in self.starts)
        excess = [above(self.by, one.cost, best) for one in self.starts]
        higher = [more for more in excess if more > SAME]
        here = len(excess) - len(higher) - len(self.rivals)
        if len(self.starts) > 1:
            ended = f"{here} of {len(excess)} starts ended at this minimum"
            yield f"{ended}, {len(higher)} {_HIGHER[self.by](min(higher))} or more" if higher else ended
        if self.rivals:
            values = ", ".join(f"{name} = {value:.5g}" for name, value in self.rivals[0].items())
            yield f"{values} fit as well, within 1 %: the records do not tell which; narrow a range so that one is left"
        if not any(one.settled and more <= SAME for one, more in zip(self.starts, excess, strict=True)):
            yield f"the search did not settle; take more starts, {_UNSETTLED[self.by]}"


def above(by: str, cost: float, best: float) -> float:
    """How far a cost lies above another: a share of squares, a difference of logarithms."""
    if by == "prediction":
        return cost - best
    return cost / best - 1 if best else 0.0


_HIGHER: Mapping[str, Callable[[float], str]] = {
    "simulation": lambda more: f"at {1 + more:.3g} times its cost",
    "prediction": lambda more: f"less likely by a factor exp({more:.3g})",
}


def structure(plant: System, free: Sequence[Signal], offset: Sequence[Signal]) -> Structure | None:
    """What no record tells of these parameters and the offsets of these outputs, beside what these records do not; None
    where derivatives of the outputs say nothing.

        rank d(y, y', ..)/d(x, p) - rank d(y, y', ..)/dx

    sums of the parameters and offsets p are told by the outputs at most, of almost every motion
    (`analysis/observability`). Where the Fisher information tells fewer, another record may tell the rest: one that
    moves the plant more. That no record tells a parameter is a fact where a symmetry of the whole plant moves it. A
    rank alone is a number at random points, and one on a branch of a plant with kinks says nothing of a record that
    changes the branch, by which a threshold is told.
    """
    added = {y: Signal(f"offset_of_{y.name}", y.unit, nominal=0) for y in offset}
    shifted = tuple(h + added.get(y, 0) for y, h in zip(plant.outputs, plant.output, strict=True))
    asked = replace(plant, parameters=(*plant.parameters, *added.values()), output=shifted)
    try:
        whole = observability(asked, unknown=(*(p.name for p in free), *(o.name for o in added.values())))
    except (NothingMeasured, NowhereDefined, NoTape):
        return None
    names = {p.name: p.name for p in free} | {o.name: f"offset of {y.name}" for y, o in added.items()}
    joint = whole.joint
    if joint is None:
        return None
    proved = () if whole.asked else joint.lost
    return Structure(
        joint.rank.rank - whole.rank,
        len(names),
        tuple(names[s.name] for s in joint.rank.unobservable if s.name in names and s in proved),
        tuple(names[s.name] for s in joint.rank.unobservable if s.name in names and s not in proved),
        tuple(map(str, joint.symmetries)),
        tuple(s.name for s in joint.repairs if s not in added.values()),
    )


def parted(V: Array, hidden: Array) -> Array:
    """The directions V (q, k), orthonormal, turned so that as many as can be have parts of the `hidden` (q) alone."""
    if hidden.all() or not hidden.any():
        return V
    turned = V @ np.linalg.svd(V[~hidden])[2].T
    return np.where(np.abs(turned) > NONE, turned, 0.0)
