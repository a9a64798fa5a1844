"""What a fit found, and what it is worth."""

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import asdict, dataclass
from typing import Any, Literal

import numpy as np

from hgogen.identification.solution import Solution
from hgogen.identification.structural import Structure
from hgogen.identification.whiteness import Whiteness
from hgogen.system import System

Array = np.ndarray
Place = Literal["", "low", "high"]
FINE = 1e-4  # of the spread of an output: smaller residuals are those of the method
SAME = 1e-2  # of the cost, or of its logarithm where it is one, by which starts may differ that ended at one minimum


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


@dataclass(frozen=True, eq=False)
class Fit:
    """What `fit` found.

    `by`: "simulation" or "prediction", the error that is least, of which the residuals are; `plant`: with the fitted
    values; `parameters`, `offsets` and `lags` of outputs: their estimates; `first`: the state of each record at its
    first sample; `fitted`: the outputs (N, p) of each, NaN where nothing was measured; `error`: RMS of each output's
    residual, in its unit; `spread`: that of the output about its mean; `unfitted`: that of the residual of the plant as
    it was given, its states fitted alone; `alike`: how many residuals of each output tell as much as one that is
    independent of the others; `untold`: directions of parameters that the records do not tell, each by its parts in
    units of ranges; `joint`: where there are some, what no record tells; `confined`: the states that lie at an end of
    their range; `starts`: how each ended, of a robust fit its last pass; `outlying`: of each output the share of the
    residuals beyond 5 deviations, these by their median; `whiteness`: Ljung and Box's test of each output's residuals,
    of innovations over their deviations; `rivals`: parameters, lags and offsets of starts that ended elsewhere at the
    same cost, as two time constants that may be exchanged do; `noise`: by prediction, the density of process noise by
    state, next to nothing of one whose rate is by definition another state, and the deviation of a sample by output: Q,
    and R over the period, of a `riccati` on the plant's own coordinates.
    """

    by: str
    plant: System
    parameters: tuple[Estimate, ...]
    lags: tuple[Estimate, ...]
    offsets: tuple[Estimate, ...]
    first: tuple[dict[str, float], ...]
    fitted: tuple[Array, ...]
    error: dict[str, float]
    spread: dict[str, float]
    unfitted: dict[str, float]
    alike: dict[str, float]
    untold: tuple[dict[str, float], ...]
    joint: Structure | None
    confined: tuple[str, ...]
    starts: tuple[Solution, ...]
    outlying: dict[str, float]
    whiteness: dict[str, Whiteness | None]
    rivals: tuple[dict[str, float], ...]
    noise: tuple[dict[str, float], dict[str, float]]

    def as_dict(self) -> dict[str, Any]:
        """For JSON."""
        return {
            "by": self.by,
            "parameters": {one.name: one.value for one in self.parameters},
            "deviation": {one.name: one.deviation for one in self.parameters},
            "nominal": {one.name: one.nominal for one in self.parameters},
            "at_end": {one.name: one.at for one in self.parameters if one.at},
            "lags": {one.name: one.value for one in self.lags},
            "offsets": {one.name: one.value for one in self.offsets},
            "first": list(self.first),
            "error": self.error,
            "spread": self.spread,
            "unfitted": self.unfitted,
            "alike": self.alike,
            "untold": list(self.untold),
            "joint": asdict(self.joint) if self.joint else None,
            "confined": list(self.confined),
            "outlying": self.outlying,
            "whiteness": {name: test.as_dict() if test else None for name, test in self.whiteness.items()},
            "rivals": list(self.rivals),
            "noise": dict(zip(("process", "sample"), self.noise, strict=True)),
            "starts": [{"cost": s.cost, "status": s.status, "iterations": s.iterations} for s in self.starts],
        }

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


_COLOURED = {
    "simulation": "the plant does more than the model, or the noise is slow, as that of a coarse encoder; where noise "
    "moves the plant, --by prediction (by=) fits it along",
    "prediction": "they can be predicted, so that the model, or the time of an input or sensor, is off",
}
_HIGHER: Mapping[str, Callable[[float], str]] = {
    "simulation": lambda more: f"at {1 + more:.3g} times its cost",
    "prediction": lambda more: f"less likely by a factor exp({more:.3g})",
}
_UNSETTLED = {
    "simulation": "narrower ranges, or, of a plant that is unstable or that noise moves, --by prediction",
    "prediction": "or narrower ranges",
}
