"""Draws figures of the papers with this package: `python docs/paper_figures.py -o build/papers`.

They are to be looked at: what can be compared is in the tests. Figures 2 and 3 of Alessandri 2020 depend on how long a
value of the noise is held, which the paper does not say: here for one step of 1 ms.
"""

import argparse
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import paper_panels
from matplotlib.figure import Figure

import hgogen as hg
from hgogen.estimators.theta import logistic, smoothstep
from hgogen.model import load
from hgogen.run import figures
from hgogen.trial import Trajectory, Trial, simulate

MODELS = Path(__file__).parent.parent / "models"
REAL = (-2.5 + 0.3j, -2.5 - 0.3j, -2, -1.3)
INSIDE, OUTSIDE = (*REAL, -1 + 0.2j, -1 - 0.2j, -0.1, -0.4), (*REAL, -1 + 0.6j, -1 - 0.6j, -0.1, -0.4)
ALPHA, BETA = 0.1, 0.1
LIMITED = {"saturate": {"x4": 25}, "arguments": False}  # phi limited in value, as in the paper


def filtered_injection() -> Iterator[tuple[str, Figure]]:
    """Astolfi, Jungers, Zaccarian 2018, figures 3 to 7."""
    for number, poles in ((3, INSIDE), (5, OUTSIDE)):
        yield f"astolfi_2018_{number}", paper_panels.poles(poles, ALPHA, BETA)
        yield f"astolfi_2018_{number + 1}", paper_panels.core(poles, ALPHA, BETA)
    model = load(MODELS / "hyperjerk.py")
    form = hg.forms.triangular(model.plant)
    exact = simulate(form.system, Trial("figure 7", 5, {"x1": -0.9, "x2": 0, "x3": 0, "x4": 0}), 1e-3)
    sizes = {}
    for name, k in (("high_gain", 4), ("filtered", 5), ("filtered", 10)):
        gains = {**model.module.tuning[name], "theta": k}
        step = hg.sample(getattr(hg.observers, name)(form, **gains, **LIMITED), hg.methods.rk4, 1e-3)
        sizes[f"{name}, k = {k}"] = step.run(y=exact.y).x - exact.x
    yield "astolfi_2018_7", paper_panels.sizes(exact.t, sizes, "s")


def adaptive_gain() -> Iterator[tuple[str, Figure]]:
    """Alessandri 2020, figures 2 and 3: noise of the measurement, and a torque that is noise."""
    model = load(MODELS / "disturbed_pendulum.py")
    form, rng = hg.forms.triangular(model.plant), np.random.default_rng(0)
    observer = hg.observers.adaptive_lmi(form, **{**model.module.tuning["adaptive_lmi"], "initial": (1, 1, 1)})
    trial = Trial("pendulum", 2.0, {"x1": 0, "x2": 0, "x3": 0.01})
    quiet = simulate(form.system, trial, 1e-3)
    noisy = quiet.y + rng.uniform(-0.1, 0.1, quiet.y.shape)
    pushed = replace(quiet, x=_pushed(quiet.t, rng.uniform(-100, 100, len(quiet.t))))
    pushed = replace(pushed, y=pushed.x[:, :1])
    for number, truth, y in ((2, quiet, noisy), (3, pushed, pushed.y)):
        step = hg.sample(observer, hg.methods.rk4, dt=1e-3)
        run = step.run(y=y)
        seen = Trajectory(trial, 0, truth, y, run.x, run.traces, run.status, run.engine)
        yield f"alessandri_2020_{number}_states", figures.states(step, seen)
        yield f"alessandri_2020_{number}_gamma", figures.adaptation(step, run.t, run.traces)


def _pushed(t: np.ndarray, w: np.ndarray) -> np.ndarray:
    """x (N, 3) of the pendulum under x3' = w, held from sample to sample, from (0, 0, .01)."""
    x, path, h = np.array([0.0, 0.0, 0.01]), [], t[1] - t[0]
    for push in w:
        path.append(x)
        slope = np.array([x[1], -0.5 * np.sin(x[0]) - 0.5 * x[1] + x[2], push])
        middle = x + h / 2 * slope
        x = x + h * np.array([middle[1], -0.5 * np.sin(middle[0]) - 0.5 * middle[1] + middle[2], push])
    return np.array(path)


def theta() -> Iterator[tuple[str, Figure]]:
    """mu of Boizot, Busvelle, Gauthier 2010 and of the reference trial, and the thetas of a bank."""
    laws = {"smoothstep .16, .32": smoothstep(0.16, 0.32), "logistic .16, 500": logistic(0.16, 500)}
    yield "boizot_2010_mu", paper_panels.share(laws, 0.4, "y^2 s")
    yield "busvelle_bank_theta", paper_panels.thetas(8.0, 0.1, 5, 10.0, 100.0, "s")


def main() -> None:
    """Writes each as SVG and PNG."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("-o", "--output", type=Path, default=Path("build/papers"))
    folder = parser.parse_args().output
    folder.mkdir(parents=True, exist_ok=True)
    for drawn in (filtered_injection(), adaptive_gain(), theta()):
        for name, figure in drawn:
            for file, content in figures.files(name, figure).items():
                (folder / file).write_bytes(content)
                print(folder / file)


if __name__ == "__main__":
    main()
