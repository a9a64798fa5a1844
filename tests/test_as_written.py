"""Functions stay as a plant writes them where `check` shows an expression; what is known of it stays the same."""

import pytest
import sympy as sp

import hgogen as hg

X1, X2 = (hg.Signal(f"x{i}", low=-1, high=1) for i in (1, 2))


@pytest.mark.ordinary("flow0-output0-(1 - tanh(x1)**2)**2", "flow2-output2-x1*(1 - tanh(x2)**2)")
@pytest.mark.parametrize(
    ("flow", "output", "text"),
    [
        ((X2, -X1), sp.tanh(X1), "(1 - tanh(x1)**2)**2"),
        ((sp.tanh(X2 - X1), -X1), X1, "1 - tanh(x1 - x2)**2"),
        ((sp.tanh(X2) * X1, -X1), X1, "x1*(1 - tanh(x2)**2)"),
        ((sp.sinh(X2), -X1), X1, "cosh(x2)"),
        ((sp.exp(X2), -X1), X1, "exp(x2)"),
    ],
)
def test_functions_stay_as_they_are_written(flow: tuple[sp.Expr, ...], output: sp.Expr, text: str) -> None:
    """tanh is no quotient of exponentials, in any text; what is proved does not change."""
    plant = hg.System("p", states=(X1, X2), outputs=(hg.Signal("y"),), flow=flow, output=[output])
    singularity = hg.singularity(plant)
    (check,) = singularity.checks[:1]
    assert f"their Jacobian is {text}, which" in str(check.reason) or str(check.reason).endswith(
        f"their Jacobian is {text}"
    )
    assert singularity.as_dict()["determinants"][0] == text
    assert "exp" not in singularity.latex().replace("e^{", "exp") or text.startswith("exp")
    at = {X1: sp.Rational(3, 7), X2: sp.Rational(-2, 5)}
    gradients = [
        [e.diff(x) for x in (X1, X2)]
        for e in (output, sum(output.diff(x) * f for x, f in zip((X1, X2), flow, strict=True)))
    ]
    exact = sp.Matrix(gradients).det().subs(at)
    assert abs(float(exact - sp.sympify(text, {"x1": X1, "x2": X2}).subs(at))) < 1e-12
    shown = hg.forms.phase(plant).checks
    (rank,) = (c for c in shown if c.id == "phase.rank")
    assert f"det dPhi/dx = {text} has no zero" in str(rank.claim)


def test_a_condition_reads_as_the_plant_is_written() -> None:
    """y = x1 tanh(x2) with x1' = x1, x2' = 1: the determinant is 0 on a curve in tanh, found by exponentials."""
    plant = hg.System(
        "p", states=(X1, X2), outputs=(hg.Signal("y"),), flow=[X1, sp.Integer(1)], output=[X1 * sp.tanh(X2)]
    )
    (check, *_) = hg.singularity(plant).checks
    assert check.verdict is hg.Verdict.WHERE
    assert "exp" not in str(check.reason)
    assert "tanh(x2)" in str(check.reason) or "x1 != 0" in str(check.reason)
