"""The triangular (observability canonical) form for one output.

    z' = A(u) z + b(z, u),   y = C(u) z,
    A = superdiagonal a_2(u)..a_n(u),   C = (a_1(u), 0..0),   0 < a_m <= a_i(u) <= a_M,
    b_i of z_1..z_i and u only, Lipschitz; with the option `measured`, a_i(u, z_1) for i >= 2, with a_i z_i Lipschitz,
    so that (a_i(u, z_1) - a_i(u, x_1)) x_i counts as b does.

z is a permutation of the plant's state, with some signs reversed. The order follows the dependencies: the output reads
one state, that state's derivative the next, and so on. A known offset c(u), as in y = a_1(u) z_1 + c(u), stays in the
output; it changes no innovation.

N. Boizot, E. Busvelle, J.-P. Gauthier, "An adaptive high-gain observer for nonlinear systems", Automatica 46
(2010), form (3).
"""

from hgogen.analysis.chain import Chains, Shape, levelwise, of_plant, structure
from hgogen.analysis.coordinates import coordinates, form_in, triangle
from hgogen.analysis.hypotheses import sign
from hgogen.form import Form, SurveySettings, one_output
from hgogen.system import System

_REFERENCE = "Boizot, Busvelle, Gauthier, Automatica 46 (2010), form (3)"
_ONE = (
    ", and the triangular form takes one; keep one of them, or use the form original, in a tuning "
    'form = "original" (block forms are for several)'
)


@SurveySettings(1, ({}, {"measured": True}), most=1)
def triangular(plant: System, *, measured: bool = False) -> Form:
    """Return the plant in triangular form z_i' = a_(i+1)(u) z_(i+1) + b_i(z_1..z_i, u), y = a_1(u) z_1 + c(u), by
    permutation and sign of its states.

    Args: `measured`: a_2..a_n may also vary with the measured state z_1, A(u, z_1).

    The form equals the plant whatever the verdicts: where the structure is not proved, b contains the terms that A does
    not. A plant whose structure is refuted keeps its own order and has only that check; observers refuse it.

    Checks: `triangular.structure`; `triangular.a_1`..`triangular.a_n` (0 < a_m <= a_i <= a_M on the box of inputs,
    parameters and, where a_i varies with it, z_1); `triangular.offset` (c is defined there) where there is one;
    `triangular.lipschitz`, of b and the a_i(u, z_1) z_i.

    Raises: `OneOutput`.
    """
    one_output(plant, _ONE)
    shape, chains = Shape.MEASURED if measured else Shape.CONSTANT, levelwise(of_plant(plant))
    answer = chains.answer(shape)
    refused = chains.broken or answer[0] is False
    fix = _fix(chains, shape, plant) if refused else ""
    check = structure("triangular", "each equation brings in one new state, linearly", answer, fix)
    if refused:
        return form_in(coordinates(plant), "triangular", (check,), _REFERENCE)
    return triangle(check, _REFERENCE, plant, chains, shape)


def _fix(chains: Chains, shape: Shape, plant: System) -> str:
    if shape is Shape.CONSTANT and chains.answer(Shape.MEASURED)[0]:
        return "Let slopes vary with the measured state, by the form's option measured, which riccati takes."
    if chains.answer(Shape.UNIFORM)[0] and all(sign(link.slope, plant) for link in chains.links[0]):
        return "Use the form uniform, for slopes that vary and keep off zero, which riccati takes."
    return "Measure another output."
