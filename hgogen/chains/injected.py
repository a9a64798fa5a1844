"""The chains of a form with the output error injected by a gain, and a nonlinear part beside."""

from collections.abc import Callable, Mapping, Sequence

import casadi as ca

from hgogen.chains.scaled_gain import ScaledGain
from hgogen.graph import Graph
from hgogen.part import Ode
from hgogen.structure.dynamics import Dynamics
from hgogen.structure.spare import mean

Rest = Callable[[Mapping[str, Graph], Graph, Graph, Graph], Mapping[str, Graph]]


def injected_chains(dynamics: Dynamics, K: ScaledGain, weights: Sequence[float], rest: Rest) -> Ode:
    """z' = A z + K (y - C z - offset) + rest, of a form whose A and C read no input, the errors of outputs that show
    one state in their mean by `weights` (p); the fields and K's values are left to the observer."""
    n, still = dynamics.n, ca.SX.zeros(len(dynamics.form.system.inputs))
    A, C = dynamics.linear(still), dynamics.output_jacobian(ca.SX.zeros(n), still)

    def linear(values: Mapping[str, Graph], y: Graph, valid: Graph) -> dict[str, Graph]:
        return {"z": A @ values["z"] + K.onto(mean(dynamics.form, weights, y - C @ values["z"], valid), n)}

    return Ode((), rest, linear, lambda u: dynamics.output(ca.SX.zeros(n), u))
