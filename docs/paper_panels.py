"""Figures as papers have them, which no trial of a model shows: poles in the plane, the course of mu, thetas of a bank.

    poles        those of A - L C with the parabola of S_(alpha, beta)     Astolfi, Jungers, Zaccarian 2018, 3 and 5
    core         those of M, with the axis of their symmetry               4 and 6
    sizes        |x - xhat| of several observers over time                 7
    share        mu over the innovation                                    Boizot, Busvelle, Gauthier 2010
    thetas       theta of each member of a bank, restarted by turns        Busvelle's slides

`paper_figures.py` draws them all.
"""

from collections.abc import Mapping, Sequence

import casadi as ca
import numpy as np
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from hgogen.estimators.theta import Logistic, Smoothstep
from hgogen.program import sym
from hgogen.prove.design import core_eigenvalues, gain_of_poles, inside_parabola
from hgogen.run.figures import COLOURS, DASHES, ESTIMATE, STYLE, TRUTH, WIDTH, line_style, panels, thinned

_HEIGHT, _POINTS = 2.6, 600
_OUT = "#cc00cc"  # the paper's magenta


def poles(of: Sequence[complex], alpha: float, beta: float) -> Figure:
    """The poles of A - L C, and the parabola alpha^2 Re + beta Im^2 = 0 in whose inside they are to lie; squares of
    those outside."""
    inside = np.array(inside_parabola(of, alpha, beta))
    points = np.array(of, dtype=complex)
    with rc_context(STYLE):
        figure, axis = _plane()
        left = 1.1 * float(points.real.min())
        reach = np.sqrt(-left / beta) * alpha  # where the parabola leaves the figure
        im = np.linspace(-reach, reach, _POINTS)
        axis.plot(-beta / alpha**2 * im**2, im, color=TRUTH, label=r"$\alpha^2$ Re + $\beta$ Im$^2$ = 0")
        axis.plot(points.real[inside], points.imag[inside], "x", color=COLOURS[1], label="inside")
        if not inside.all():
            axis.plot(points.real[~inside], points.imag[~inside], "s", color=_OUT, fillstyle="none", label="outside")
        axis.set_xlim(left, -0.1 * left)
        _named(figure)
    return figure


def core(of: Sequence[complex], alpha: float, beta: float) -> Figure:
    """The eigenvalues of M for these poles of A - L C, and the axis -alpha/2 about which they are symmetric; squares of
    those that do not decay."""
    values = np.array(core_eigenvalues(gain_of_poles(of), alpha, beta))
    stable = values.real < 0
    with rc_context(STYLE):
        figure, axis = _plane()
        axis.axvline(-alpha / 2, color=ESTIMATE, label=r"Re = $-\alpha/2$")
        axis.axvline(0, color=TRUTH, linewidth=0.5)
        axis.plot(values.real[stable], values.imag[stable], "x", color=COLOURS[1], label="stable")
        if not stable.all():
            axis.plot(values.real[~stable], values.imag[~stable], "s", color=_OUT, fillstyle="none", label="unstable")
        _named(figure)
    return figure


def sizes(t: np.ndarray, of: Mapping[str, np.ndarray], unit: str) -> Figure:
    """The size of each error (N, n) over time, by the name of its observer."""
    with rc_context(STYLE):
        figure, (axis,) = panels(1, t, unit)
        for k, (name, error) in enumerate(of.items()):
            axis.plot(
                *thinned(t, np.linalg.norm(error, axis=1)), color=COLOURS[k % 7], linestyle=DASHES[k % 4], label=name
            )
        axis.set_ylabel(r"$|x - \hat x|$")
        axis.set_ylim(bottom=0)
        _named(figure)
    return figure


def share(of: Mapping[str, Smoothstep | Logistic], most: float, unit: str) -> Figure:
    """mu over the innovation, from 0 to `most`, by names."""
    innovation, at = np.linspace(0, most, _POINTS), ca.SX.sym("I")
    with rc_context(STYLE):
        figure, (axis,) = panels(1, innovation, unit)
        for k, (name, law) in enumerate(of.items()):
            gains, values = zip(*((sym("gain", gain.name), ca.SX(gain.initial[0])) for gain in law.gains), strict=True)
            graph = ca.substitute([law.fraction(at)], list(gains), list(values))  # the program's own
            mu = np.array(ca.Function("mu", [at], graph)(innovation[None])).ravel()
            axis.plot(innovation, mu, color=COLOURS[k % 7], linestyle=DASHES[k % 4], label=name)
        axis.set_ylabel(r"$\mu$")
        axis.set_xlabel(f"innovation $I_d$ ({unit})")
        _named(figure)
    return figure


def thetas(theta_0: float, rate: float, count: int, period: float, end: float, unit: str) -> Figure:
    """theta of each of the `count` members of a bank, one of which restarts at theta_0 every `period`."""
    t = np.linspace(0, end, 4 * _POINTS)
    with rc_context(STYLE):
        figure, (axis,) = panels(1, t, unit)
        for k in range(count):
            since = np.where(t < k * period, t, (t - k * period) % (count * period))  # all begin at theta_0
            axis.plot(t, 1 + (theta_0 - 1) * np.exp(-rate * since), **line_style(k))
        axis.axhline(1, color=TRUTH, linewidth=0.5)
        axis.set_ylabel(r"$\theta$")
        axis.set_ylim(0, 1.05 * theta_0)
    return figure


def _named(figure: Figure) -> None:
    """Names the lines above the panel."""
    figure.legend(loc="upper right", ncols=4, bbox_to_anchor=(0.98, 1.0), borderaxespad=0.2, handlelength=1.6)


def _plane() -> tuple[Figure, Axes]:
    figure = Figure(figsize=(WIDTH / 1.6, _HEIGHT))
    axis = figure.subplots()
    figure.subplots_adjust(left=0.14, right=0.97, bottom=0.17, top=0.88)
    axis.xaxis.set_major_locator(MaxNLocator(5))
    axis.set_xlabel("Re")
    axis.set_ylabel("Im")
    return figure, axis
