"""What a fit found, and what it is worth."""

import math
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from hgogen.identification.solution import Solution
from hgogen.system import System

Array = np.ndarray
Place = Literal["", "low", "high"]
FOLLOWING = 5.0  # residuals that tell as much as one, of which a note is made
FINE = 1e-4  # of the spread of an output: smaller residuals are those of the method
SAME = 1e-2  # of the cost, by which starts may differ that ended at one minimum


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

    `plant`: with the fitted values; `parameters`, `offsets` and `lags` of outputs: their estimates; `first`: the state
    of each record at its first sample; `fitted`: the outputs (N, p) of each, NaN where nothing was measured; `error`:
    RMS of each output's residual, in its unit; `spread`: that of the output about its mean; `unfitted`: that of the
    residual of the plant as it was given, its states fitted alone; `alike`: how many residuals of each output tell as
    much as one that is independent of the others; `untold`: directions of parameters that the records do not tell, each
    by its parts in units of ranges; `confined`: the states that lie at an end of their range; `starts`: how each ended,
    of a robust fit its last pass; `outlying`: of each output the share of the residuals beyond 5 deviations, these by
    their median.
    """

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
    confined: tuple[str, ...]
    starts: tuple[Solution, ...]
    outlying: dict[str, float]

    def as_dict(self) -> dict[str, Any]:
        """For JSON."""
        return {
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
            "confined": list(self.confined),
            "outlying": self.outlying,
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
        for parts in self.untold:
            total = " ".join(f"{part:+.2g} {name}" for name, part in parts.items())
            fix = "fix one of them" if len(parts) > 1 else "fix it, or move the plant more"
            lines.append(f"the records do not tell {total}, in units of ranges: it stays near its start; {fix}")
        for name, tau in self.alike.items():
            if self.error[name] >= self.spread[name] > 0:
                lines.append(f"{name} is followed no better than by its mean; are its unit, sign and offset right?")
            if tau > FOLLOWING and self.error[name] > FINE * self.spread[name]:
                share = f"{tau:.3g} of them tell as much as one, which the standard errors count"
                lines.append(
                    f"residuals of {name} follow each other, {share}: the plant does more than the model, or "
                    "the noise is slow, as that of a coarse encoder"
                )
        for name, part in self.outlying.items():
            if part and self.error[name] > FINE * self.spread[name]:
                lines.append(f"{part:.2g} of the residuals of {name} lie beyond 5 times their typical size")
        best = min(one.cost for one in self.starts)
        higher = [one.cost / best for one in self.starts if one.cost > best * (1 + SAME)] if best else []
        if len(self.starts) > 1:
            ended = f"{len(self.starts) - len(higher)} of {len(self.starts)} starts ended at this minimum"
            lines.append(f"{ended}, the others at {min(higher):.3g} times its cost or more" if higher else ended)
        if not any(one.settled and one.cost <= best * (1 + SAME) for one in self.starts):
            lines.append("the search did not settle; take more starts, or narrower ranges")
        return tuple(lines)
