"""Searches of gains and proofs, and what may differ between machines: the last digits of a solver's answers, the order
and the scale of its constraints, how many threads add up a sum, and which kernels of BLAS do.

    .venv/bin/python tests/perturbed.py SEARCH    what one of them finds, as JSON
"""

import json
import os
import signal
import subprocess
import sys
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
import pytest
from plants import MODELS, model, pendulum

import hgogen as hg
from hgogen.model import load
from hgogen.prove import semidefinite

RATIO = 1.05  # the largest ratio of two bounds that are found of one thing
KERNELS = ("Haswell", "SkylakeX", "Zen", "Nehalem")  # of OpenBLAS; one that it does not know leaves its own choice
NOISE = {"y": 1e-3}
_PLAIN = semidefinite._solution.__wrapped__
Answer = Mapping[str, float | str]  # a bound or a verdict, by what it is of


# --- searches


def _checks(checks: Any) -> dict[str, str]:
    return {str(check.id): check.verdict.value for check in checks}


def _step(observer: str = "high_gain", dt: float = 0.01) -> hg.Step:
    gains = load(MODELS / "pendulum.py").module.tuning[observer]
    return hg.sample(getattr(hg.observers, observer)(hg.forms.triangular(model("pendulum")), **gains), dt=dt)


def _filtered() -> hg.Step:
    """Of fast modes that a slow noise hardly moves: the P of its bound is far from that of its rate."""
    gains = {"F": ((-36, 2.6), (1, -18)), "G": (1, 0), "H": ((41, -6.8), (7, -2))}
    return hg.sample(
        hg.observers.filtered_injection(hg.forms.triangular(model("pendulum")), theta=20, **gains), dt=1e-3
    )


def _common_norm(name: str) -> Answer:
    system = model(name)
    observer = hg.observers.high_gain(hg.forms.triangular(system), theta=8, poles=(-1,) * len(system.states))
    proofs = {check.id.fact: check.proofs[0].fact for check in observer.checks if check.id.maker == "high_gain"}
    bounds = {"least theta": float(proofs["convergence"].theta), "rate": proofs["theta"].falls.rate}
    return bounds | _checks(observer.checks)


def _contraction() -> Answer:
    known = hg.contraction(_step())
    return {"rate": known.rate or 0.0, "longest": float(known.reach.longest or 0)} | _checks(known.checks)


def _noise(step: hg.Step) -> Answer:
    known = hg.noise_gain(step)
    return {f"{y} to {x}": bound for (x, y), bound in known.gains.items()} | _checks([known.check])


def _start() -> Answer:
    known = hg.start_set(_step())
    return {"multiple": known.multiple} | dict(known.peaks)


def _error_bound() -> Answer:
    known = hg.error_bound(_step(), noise=NOISE, disturbance={"w": 0.2}, rates={"tau": 5})
    return dict(known.bounds) | _checks([known.check])


def _l2() -> Answer:
    known = hg.l2_gain(pendulum(theta=20), noise=NOISE, disturbance={"w": 0.2})
    return {"gain": known.gain or 0.0} | _checks([known.check])


def _iss() -> Answer:
    known = hg.iss_gain(pendulum(theta=20), noise=NOISE, disturbance={"w": 0.2})
    return dict(known.bounds) | _checks([known.check])


def _gain(argument: bool) -> Answer:
    form = hg.forms.triangular(model("pendulum"))
    searched: Any = hg.design.gain.__wrapped__  # type: ignore[attr-defined]  # which remembers nothing
    known = searched(form, rate=12 if argument else 15, argument=argument)
    return {f"{y} to {x}": bound for (x, y), bound in known.bounds.items()}


def _injection() -> Answer:
    return {
        "w": float(hg.design.injection_filter(hg.forms.triangular(model("pendulum")), theta=20, rate=2, size=1).bound)
    }


def _adaptive() -> Answer:
    known = hg.design.adaptive_gain(hg.forms.triangular(model("pendulum")))
    return {"gamma": float(known.gamma)}


SEARCHES: dict[str, Callable[[], Answer]] = {
    "common norm": lambda: _common_norm("pendulum"),
    "common norm of four states": lambda: _common_norm("hyperjerk"),
    "contraction": _contraction,
    "noise": lambda: _noise(_step()),
    "noise of a filter": lambda: _noise(_filtered()),
    "start set": _start,
    "error bound": _error_bound,
    "L2 gain": _l2,
    "ISS gain": _iss,
    "gain": lambda: _gain(False),
    "gain and argument": lambda: _gain(True),
    "injection filter": _injection,
    "adaptive gain": _adaptive,
}


# --- what may differ


class Perturbation:
    """A solver whose "answers" are off by a random share of its tolerance, or which is given its "constraints" in
    another order and in other units, at random; `asked`: how often it was."""

    def __init__(self, what: str, seed: int) -> None:
        self.what, self.draw, self.asked = what, np.random.default_rng(seed), 0

    def solution(self, costs: bytes, matrix: bytes, ends: bytes, kinds: Any, close: float) -> Any:
        """In the place of `semidefinite._solution`."""
        self.asked += 1
        if self.what == "answers":
            known = _PLAIN(costs, matrix, ends, kinds, close)
            return known and tuple(self._off(each, close) for each in known)
        variables = len(costs) // 8
        A, b = np.frombuffer(matrix).reshape(-1, variables), np.frombuffer(ends)
        cuts = np.cumsum([size for size, _ in kinds])[:-1]
        rows = np.split(np.arange(len(b)), cuts)
        order, units = self.draw.permutation(len(kinds)), 2.0 ** self.draw.integers(-2, 3, len(kinds))
        places = np.concatenate([rows[k] for k in order])
        unit = np.concatenate([np.full(len(rows[k]), units[k]) for k in order])
        A, b = A[places] * unit[:, None], b[places] * unit
        known = _PLAIN(costs, A.tobytes(), b.tobytes(), tuple(kinds[k] for k in order), close)
        if known is None:
            return None
        prices = np.empty(len(b))
        prices[places] = known[1] * unit
        return known[0], prices

    def _off(self, values: Any, share: float) -> Any:
        return values * (1 + share * self.draw.standard_normal(np.shape(values)))


def perturbed(patch: Any, what: str, seed: int) -> Perturbation:
    """Has the solver perturbed from here on, as long as `patch`, the tests' monkeypatch, lasts."""
    other = Perturbation(what, seed)
    patch.setattr(semidefinite, "_solution", other.solution)
    return other


def elsewhere(search: str, kernel: str, threads: int) -> Answer:
    """What a search finds in a process of its own, with the kernels of BLAS of a processor and so many threads.

    Skips the test on a processor that lacks instructions of these kernels, AVX-512 for one.
    """
    counts = dict.fromkeys(("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "RAYON_NUM_THREADS"), str(threads))
    done = subprocess.run(
        [sys.executable, __file__, search],
        env={**os.environ, "OPENBLAS_CORETYPE": kernel, **counts},
        capture_output=True,
        text=True,
    )
    if done.returncode == -signal.SIGILL:
        pytest.skip(f"this processor lacks instructions of the kernels of {kernel}")
    done.check_returncode()
    answer: Answer = json.loads(done.stdout)
    return answer


def differences(one: Answer, other: Answer) -> list[str]:
    """In what two answers differ: verdicts at all, bounds by more than a search may."""
    said = [f"{name} is there in one only" for name in one.keys() ^ other.keys()]
    for name in one.keys() & other.keys():
        a, b = one[name], other[name]
        alike = a == b if isinstance(a, str) or isinstance(b, str) else b / RATIO <= a <= b * RATIO
        said += [] if alike else [f"{name}: {a} and {b}"]
    return said


if __name__ == "__main__":
    print(json.dumps(SEARCHES[sys.argv[1]]()))
