"""What a certificate holds of the map to phase coordinates, Phi = (y, y', .., y^(n-1)), in the plant's states."""

from dataclasses import dataclass

import sympy as sp

from hgogen.algebra.points import exact
from hgogen.analysis.determinant import determinant
from hgogen.analysis.lie import derivatives, rates, without_rates
from hgogen.evidence.enclosing import enclosure
from hgogen.evidence.grounds import Evidence
from hgogen.form import Form
from hgogen.intervals.box import box
from hgogen.intervals.sign import nonzero
from hgogen.structure.univalent import Weights, minor, subsets, weighted


class Derivatives:
    """The chain of y and its derivatives."""

    def evidence(self, form: Form) -> Evidence | None:
        """Phi = (y, y', ..), in the plant's states, its inputs and their derivatives."""
        Phi = _derivatives(form)
        return {"chain": Phi} if Phi else None


class FullRank:
    """det dPhi/dx away from zero."""

    def evidence(self, form: Form) -> Evidence | None:
        """The range of the determinant on the box of the plant."""
        J = _jacobian(form)
        return None if J is None else _enclosed(form, determinant(J.tolist()).value)


@dataclass(frozen=True)
class OneToOne:
    """All principal minors of weighted rows of dPhi/dx above zero."""

    weights: Weights

    def evidence(self, form: Form) -> Evidence | None:
        """The weights, and the range of each minor on the box of the plant."""
        J = _jacobian(form)
        if J is None:
            return None
        weighed, minors = weighted(self.weights, J), []
        for places in subsets(form.n):
            known = _enclosed(form, minor(weighed, places))
            if known is None:
                return None
            minors.append({"places": [place + 1 for place in places], **known})
        return {"weights": self.weights, "minors": minors}


def _enclosed(form: Form, determinant: sp.Expr) -> Evidence | None:
    """The range of a determinant of the plant's signals, with the derivatives of its inputs."""
    system, det = form.system, exact(determinant)
    known = [u.derivative(k) for u in system.inputs for k in range(form.n)]
    every = box((*known, *system.signals), system.nominal)
    where = {s: every[s] for s in sorted(det.free_symbols, key=str)}
    return enclosure(form, det, nonzero(det, where).range, where)


def _jacobian(form: Form) -> sp.Matrix | None:
    """dPhi/dx of the plant as it was declared; None of one in other coordinates."""
    Phi = _derivatives(form)
    return None if Phi is None else sp.Matrix([[entry.diff(x) for x in form.system.states] for entry in Phi])


def _derivatives(form: Form) -> tuple[sp.Expr, ...] | None:
    """Phi of the plant as it was declared; None of one in other coordinates."""
    system = form.system
    if system.origin is not None:
        return None
    return derivatives(exact(system.output[0]), rates(without_rates(system), form.n), form.n)
