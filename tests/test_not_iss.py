"""The observer that converges and is not input-to-state stable: example 1 of Alessandri 2020."""

from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import hgogen as hg
from hgogen.check import Verdict
from hgogen.model import load

MODEL = load(Path(__file__).resolve().parents[1] / "models" / "not_iss.py")


def together(t: float, s: np.ndarray) -> list[float]:
    """(29) and (30)."""
    x1, x2, z1, z2 = s
    w = 1 / np.sqrt(2 * t + 2)
    y1, y2 = x1 * (1 + x2) * w, x2
    return [
        -x1 + (1 + x2) * w,
        -2 * x1**2 + 2 * x1 * (1 + x2) * w,
        -z1 + (2 - z1 / np.sqrt(y2)) * z1 * y1 / (1 + y2),
        -z2 + 2 * y1 - y2,
    ]


@pytest.mark.parametrize("start", [0.2, 0.5, 1.0])
def test_a_fading_disturbance_drives_its_error_away(start: float) -> None:
    """e1 = sqrt(2 t + 2), e2 = exp(-t) e2(0). The first repels, d/de (-e + (1 + e^2) w) = 1 there: what is lost at
    first, 1e-13, grows by e^10."""
    first = [start, start**2, start - np.sqrt(2), start**2 - 0.5]
    t = np.linspace(0, 10, 101)
    x1, x2, z1, z2 = solve_ivp(together, (0, 10), first, t_eval=t, method="DOP853", rtol=1e-13, atol=1e-14).y
    assert x1 - z1 == pytest.approx(np.sqrt(2 * t + 2), abs=1e-8)
    assert x2 - z2 == pytest.approx(0.5 * np.exp(-t), abs=1e-10)
    assert x2 == pytest.approx(x1**2, abs=1e-11)


@pytest.mark.parametrize("mu", [2, 3, 10, 100])
def test_its_inequality_is_refuted_for_large_errors_whatever_the_gain(mu: int) -> None:
    """V = e1^2 + e2^2: true where (1 + e1^2)^2 < 3 mu^2/4, both sides to one percent."""
    e1, e2 = MODEL.module.e1, MODEL.module.e2
    edge = np.sqrt(np.sqrt(0.75) * mu - 1) if mu > 1.2 else 0
    verdicts = [
        hg.dissipation(MODEL.module.error, e1**2 + e2**2, mu=mu, within=(share * edge, 1)).checks[1].verdict
        for share in (0.99, 1.01)
    ]
    assert verdicts == [Verdict.PROVED, Verdict.REFUTED]


def test_no_small_gain_holds_even_near_zero() -> None:
    e1, e2 = MODEL.module.e1, MODEL.module.e2
    found = hg.dissipation(MODEL.module.error, e1**2 + e2**2, mu=1, within=(0.01, 0.01))
    assert found.checks[1].verdict is Verdict.REFUTED
    assert found.conclusion == "nothing is concluded"
