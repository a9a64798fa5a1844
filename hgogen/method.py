"""A method turns the differential equations of an observer into the statements of a step."""

from dataclasses import dataclass
from typing import Any, Literal, Protocol

from hgogen.covariance import covariance_ode, information_ode
from hgogen.observer import Clock, Ode, Pieces, Riccati
from hgogen.program import INF, Block, sym
from hgogen.runge_kutta import Tableau, advance
from hgogen.stability import Limit, core_limit, covariance_limit


class Method(Protocol):
    """A discretisation: one rule for differential equations, one for the covariance of a Riccati observer."""

    @property
    def name(self) -> str:
        """What reports call it."""
        ...

    def ode(self, part: Ode, clock: Clock) -> Pieces:
        """The part over one step, the measurement on the line between two valid samples."""
        ...

    def riccati(self, part: Riccati, clock: Clock) -> Pieces:
        """The Riccati observer over one step."""
        ...


@dataclass(frozen=True)
class Explicit:
    """An explicit Runge-Kutta method for any part; of a Riccati observer it integrates (z, S) or (z, P)."""

    tableau: Tableau
    view: Literal["information", "covariance"]

    @property
    def name(self) -> str:
        """What reports call it."""
        return f"{self.tableau.name}, {self.view} form" if self.view == "covariance" else self.tableau.name

    def ode(self, part: Ode, clock: Clock) -> Pieces:
        """One step of every field of the part at once."""
        start = {field.name: sym(f"state.{field.name}", field.size) for field in part.fields}

        def rate(values: Any, c: float) -> Any:
            return part.rhs(values, clock.u(c), clock.y(c), clock.valid)

        stages = advance(self.tableau, rate, start, clock.dt)
        block = Block(
            f"{', '.join(start)}: one step of {self.tableau.name}",
            {f"state.{name}": value for name, value in stages.result.items()},
            stages.names,
        )
        return Pieces(
            fields=part.fields,
            derived=part.derived,
            tune=part.tune,
            predict=(block,),
            uses_output=True,
            limit=INF if part.core is None else core_limit(part.core, self.tableau.polynomial),
            why=f"beyond it the linear error core leaves the stability region of {self.tableau.name}",
        )

    def riccati(self, part: Riccati, clock: Clock) -> Pieces:
        """z and S, or z and P, as one differential equation."""
        views = {"information": information_ode, "covariance": covariance_ode}
        pieces = self.ode(views[self.view](part), clock)
        limit = riccati_limit(part, self.tableau, self.view)
        return Pieces(
            fields=pieces.fields, predict=pieces.predict, uses_output=True, limit=limit.dt, why=limit.why
        )


def riccati_limit(part: Riccati, tableau: Tableau, view: Literal["information", "covariance"]) -> Limit:
    """The step length that the covariance equation admits on this model's box."""
    dynamics = part.dynamics
    noise, variance = part.nominal
    return covariance_limit(
        dynamics.jacobians(),
        dynamics.output_matrix(),
        noise,
        variance,
        part.covariance,
        part.theta_peak,
        tableau,
        view,
    )
