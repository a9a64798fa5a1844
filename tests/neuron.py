"""The reference example, models/fitzhugh_nagumo.py, with another theta, method or step length."""

from pathlib import Path
from typing import Any

import hgogen as hg
from hgogen import model

MODEL = model.load(Path(__file__).resolve().parents[1] / "models" / "fitzhugh_nagumo.py")
FORM = hg.forms.triangular(MODEL.plant)
STAGGERED, WINDOW = hg.innovation.staggered(1.0, predictors=4), hg.innovation.window(1.0)
SMOOTHSTEP, LOGISTIC = hg.theta.smoothstep(0.16, 0.32), hg.theta.logistic(0.16, 500.0)


def adaptive(mu: Any = SMOOTHSTEP, innovation: Any = STAGGERED) -> Any:
    """theta_1 = 4, Delta T = .1, lambda = 1."""
    return hg.theta.adaptive(4.0, rise_time=0.1, rate=1.0, mu=mu, innovation=innovation)


def observer(theta: Any, **options: Any) -> Any:
    """The model's own tuning but for theta and the options."""
    return hg.observers.riccati(FORM, **{**MODEL.module.tuning["riccati"], "theta": theta, **options})


def step(
    theta: Any, method: Any = hg.methods.continuous_discrete, dt: float = 0.01, between: str = "line", **options: Any
) -> Any:
    """That observer as a step."""
    return hg.sample(observer(theta, **options), method, dt=dt, between=between)
