"""x' = f(x, t; p) by extrapolation with given steps, compiled: for many motions of one plant.

    z_1 = x + h/n f(x),   z_(j+1) = z_(j-1) + 2 h/n f(z_j),   T_i1 = z_n,   n = n_i of 2, 4, 6, 8
    T_(i,k+1) = T_ik + (T_ik - T_(i-1,k))/((n_i/n_(i-k))^2 - 1),   x+ = T_44,   e = T_44 - T_43

x+ is of order 8, e the error of T_43, of order 6. A motion counts where e stays below `LOCAL` of the peak of each
state: what it is off by is then less than what CVODES leaves. An input may jump at a given time, where a step ends.
Source: Hairer, Norsett, Wanner, Solving Ordinary Differential Equations I (1993), II.9: Gragg's rule, extrapolated.
"""

import ctypes
from collections.abc import Mapping, Sequence
from functools import cached_property
from typing import Any

import casadi as ca
import numpy as np

from hgogen.graph import Graph
from hgogen.run import native

Array = np.ndarray
ORDERED = (2, 4, 6, 8)  # n_i
LOCAL = 1e-12  # of the peak of a state, an error of T_43
_LOOP = """
void march(long long count, long long n, double* x, double* e, const double* t, const double* h, const double* p,
           long long* iw, double* w) {
  const double* arg[%d];
  double* res[%d];
  for (long long k = 0; k < count; k++) {
    arg[0] = x + k*n, arg[1] = t + k, arg[2] = h + k, arg[3] = p;
    res[0] = x + (k + 1)*n, res[1] = e + k*n;
    march_step(arg, res, iw, w, 0);
  }
}
"""


class March:
    """The motions from `times[0]` to the others.

    `ode`: graphs of the state "x", the time "t", parameters "p" and the rate "ode", as CasADi's integrators take them.
    """

    def __init__(self, ode: Mapping[str, Graph], times: Sequence[float]) -> None:
        self._ode, self._t, self._h = ode, np.asarray(times, dtype=float)[:-1], np.diff(times)

    def __call__(self, start: Array, p: Array) -> Array | None:
        """The states (k, n) at the times behind the first; None where they are not known well enough, and without a
        compiler."""
        if not native.compiler():
            return None
        count, n = len(self._t), len(start)
        states, errors = np.empty((count + 1, n)), np.empty((count, n))
        states[0] = start
        integers, numbers = np.empty(self._step.sz_iw(), dtype=np.int64), np.empty(self._step.sz_w())
        arrays = (states, errors, self._t, self._h, np.asarray(p, dtype=float), integers, numbers)
        self._march(count, n, *(each.ctypes.data for each in arrays))
        with np.errstate(all="ignore"):
            good = errors.max(axis=0) <= LOCAL * np.abs(states).max(axis=0)
        return states[1:] if good.all() else None

    @cached_property
    def _step(self) -> Any:
        """(x, t, h, p) -> x+ and |e|."""
        t, h = ca.SX.sym("t"), ca.SX.sym("h")
        x, p = self._ode["x"], self._ode["p"]
        return ca.Function("march_step", [x, t, h, p], _step(self._ode, x, t, h, p))

    @cached_property
    def _march(self) -> Any:
        generator = ca.CodeGenerator("step.c")
        generator.add(self._step)
        loop = _LOOP % (self._step.sz_arg(), self._step.sz_res())
        march = native.library({"step.c": generator.dump() + loop}, ("-O2",)).march
        march.argtypes = (*[ctypes.c_longlong] * 2, *[ctypes.c_void_p] * 7)
        march.restype = None
        return march


def _step(ode: Mapping[str, Graph], x: Graph, t: Graph, h: Graph, p: Graph) -> list[Graph]:
    """x+ and |e| of one step."""
    rate = ca.Function("rate", [ode["x"], ode["t"], ode["p"]], [ca.densify(ode["ode"])])
    first, rows = rate(x, t, p), [[x]]
    for i, n in enumerate(ORDERED):
        before, now = x, x + h / n * first
        for j in range(1, n):
            before, now = now, before + 2 * h / n * rate(now, t + j * h / n, p)
        row = [now]
        for k in range(1, i + 1):
            row.append(row[-1] + (row[-1] - rows[-1][k - 1]) / ((n / ORDERED[i - k]) ** 2 - 1))
        rows.append(row)
    return [rows[-1][-1], ca.fabs(rows[-1][-1] - rows[-1][-2])]
