"""The innovation over a sliding window, I_d(t) = integral over [t-d, t] of |y - yhat|^2, yhat predicted from z(t-d).

Source: Boizot, Busvelle, Gauthier 2010, section 2.3. Two ways to compute it, both as values for an adaptive theta:

`window(d)`: as the paper says, the model is run again from z(t - d) at every sample; N = d/dt model steps a sample and
a history of N + 1 states, inputs and outputs.

`staggered(d, predictors=M)`: M + 1 copies of the model, one restarted from z every d/M, each summing dt |y - yhat|^2.
The oldest has an age between d and d (1 + 1/M); its sum is scaled down to d by its number of valid samples and never
scaled up. M + 1 model steps a sample and no history: the default.

A sum over samples keeps dt (unit y^2 s), so thresholds do not change with dt. Missing samples are not counted. Of
several outputs I_d is the sum of weights_j |y_j - yhat_j|^2, each with its own count of valid samples; weights such as
1/variance make outputs of different units one.
"""

from collections.abc import Mapping
from typing import Any

from hgogen.discretisation.runge_kutta import HEUN, Tableau
from hgogen.kalman.predictor import BadWindowSize, Innovation, Weights
from hgogen.kalman.staggered import Staggered
from hgogen.kalman.window import Window
from hgogen.reading.given import real, reals
from hgogen.reading.named import Values
from hgogen.structure.dynamics import HUGE

__all__ = ["Innovation", "staggered", "window"]


def staggered(d: float, predictors: int = 4, method: Any = None, weights: float | Values | None = None) -> Staggered:
    """Innovation by `predictors` + 1 staggered copies of the model over a window `d` (s); Heun unless `method` says.

    `weights`: of each output's square, by name or in their order, 1 by default.

    Raises: `HgogenError` where d, the number or a weight is not positive.
    """
    _positive(d)
    if real("predictors", predictors) not in range(1, 1000):
        raise BadWindowSize(f"predictors = {predictors}", "must be a whole number, from 1 to 999")
    return Staggered(float(d), int(predictors), _tableau(method), _weights(weights))


def window(d: float, method: Any = None, weights: float | Values | None = None) -> Window:
    """Innovation as the paper defines it, the model run again over the window `d` (s) at every sample; `weights` as in
    `staggered`."""
    _positive(d)
    return Window(float(d), _tableau(method), _weights(weights))


def _positive(d: float) -> None:
    if not 0 < real("the window d", d) < HUGE:
        raise BadWindowSize(f"the window d = {d!r}", "must be a positive time")


def _tableau(method: Any) -> Tableau:
    tableau = HEUN if method is None else getattr(method, "tableau", None)
    if not isinstance(tableau, Tableau):
        reason = "must be an explicit one: methods.euler, methods.heun or methods.rk4"
        raise BadWindowSize(f"method = {method!r}", reason)
    return tableau


def _weights(declared: Any) -> Weights:
    """The weights of the outputs; () for all 1."""
    if declared is None:
        return ()
    values = list(declared.values()) if isinstance(declared, Mapping) else declared
    weights = tuple(map(float, reals("weights", values).reshape(-1)))
    if not weights or not all(0 < weight < HUGE for weight in weights):
        raise BadWindowSize(f"weights = {declared!r}", "must be positive numbers, one for each output")
    return dict(zip(declared, weights, strict=True)) if isinstance(declared, Mapping) else weights
