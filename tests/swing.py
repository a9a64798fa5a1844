"""A pendulum that swings under a slow drive, for tests of observers on it."""

from collections.abc import Callable
from functools import cache
from typing import Any

import numpy as np
import sympy as sp
from plants import model

import hgogen as hg
from hgogen.estimators.core import core_numbers, nominal
from hgogen.program import Place
from hgogen.trial import Trial, Truth, simulate, t

DT = 1e-3
TRIAL = Trial("swing", 4, start={"q": 1, "w": 0}, inputs={"tau": sp.sin(t)})


@cache
def form() -> hg.Form:
    return hg.forms.triangular(model("pendulum"))


@cache
def truth(dt: float = DT) -> Truth:
    return simulate(model("pendulum"), TRIAL, dt)


def noisy(sigma: float = 1e-3, seed: int = 0) -> np.ndarray:
    """y (N) with white noise."""
    y = truth().y[:, 0]
    return np.asarray(y + sigma * np.random.default_rng(seed).standard_normal(len(y)))


def gappy() -> np.ndarray:
    """Noisy, with samples missing: one, ten in a row, and every other of twenty."""
    y = noisy()[:2200]
    y[700] = y[1500:1510] = y[2000:2020:2] = np.nan
    return y


def run(observer: hg.Observer, y: np.ndarray, **options: Any) -> hg.Run:
    """The observer over the swing by classical Runge-Kutta."""
    return hg.sample(observer, hg.methods.rk4, dt=DT).run(u=truth().u[: len(y)], y=y, **options)


def error(observer: hg.Observer, y: np.ndarray | None = None) -> np.ndarray:
    """|estimate - truth| (N, 2)."""
    return np.abs(run(observer, truth().y if y is None else y).x - truth().x)


@cache
def _step(build: Callable[[], hg.Observer]) -> hg.Step:
    return hg.sample(build(), hg.methods.rk4, dt=DT)


def last_error(build: Callable[[], hg.Observer], q: float, w: float) -> float:
    """The largest error at the end of the swing, from the estimate (q, w)."""
    step = _step(build)
    step.reset()
    step._kept.places[Place("state", "w")][:] = q, w
    last: float = np.abs(step.run(u=truth().u, y=truth().y).x[-1] - truth().x[-1]).max()
    return last


Build = Callable[..., hg.Observer]


def core_poles(build: Build, **gains: Any) -> np.ndarray:
    """Eigenvalues of the observer's linear error core."""
    observer = build(form(), **gains)
    return np.sort_complex(np.linalg.eigvals(core_numbers(observer.parts[0], 1, nominal(observer))))
