"""Estimators with saturations inside their linear core, at the ranges of the states they estimate.

    field' = core(fields, y - o(u), saturate) + model(fields, u)

The linear error core is the one without saturation; while it acts, a state inside its range keeps the saturated
estimate at least as near as the estimate itself.
"""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import Any

from hgogen.form import Form
from hgogen.integrators import Integrators
from hgogen.observer import BadGain, Ode
from hgogen.program import Field

Saturate = Callable[[Any, int], Any]  # an SX scalar to the range of w_i


@dataclass(frozen=True, eq=False)
class Saturating(Ode):
    """An estimator with saturations in its linear core: `whole`, by field name, is its right-hand side in one piece,
    of fewer operations than linear + rest."""

    whole: Callable[[Mapping[str, Any], Any, Any, Any], Mapping[str, Any]] | None = None

    def rhs(self, values: Mapping[str, Any], u: Any, y: Any, valid: Any) -> dict[str, Any]:
        """The whole right-hand side."""
        assert self.whole is not None
        return dict(self.whole(values, u, y, valid))


def saturating(
    chain: Integrators,
    fields: tuple[Field, ...],
    core: Callable[[Mapping[str, Any], Any, Any, Saturate], Mapping[str, Any]],
    model: Callable[[Mapping[str, Any], Any], Mapping[str, Any]],
) -> Saturating:
    """field' = core(values, y - o(u), valid, saturate) + model(values, u), saturate(value, i) to the range of w_i.

    The linear error core is the one without saturation; `rest` holds what saturation takes away.
    """

    def linear(values: Mapping[str, Any], y: Any, valid: Any) -> Mapping[str, Any]:
        return core(values, y, valid, lambda value, _: value)

    def whole(values: Mapping[str, Any], u: Any, y: Any, valid: Any) -> dict[str, Any]:
        lines, terms = core(values, y - chain.offset(u), valid, chain.saturated), model(values, u)
        return {name: lines[name] + terms[name] for name in lines}

    def rest(values: Mapping[str, Any], u: Any, y: Any, valid: Any) -> dict[str, Any]:
        lines, all_ = linear(values, y - chain.offset(u), valid), whole(values, u, y, valid)
        return {name: all_[name] - lines[name] for name in lines}

    return Saturating(fields, rest, linear, chain.offset, whole=whole)


def demand_ranges(observer: str, form: Form, wanted: Iterable[int]) -> None:
    """Raises: `BadGain` where one of the states `wanted` has no range to saturate its estimate to."""
    for i in wanted:
        if not form.states[i].bounded:
            what = form.to_form[i]
            raise BadGain(f"{observer} saturates the estimate of {what}", "which has no range; declare low and high")
