"""Every claim about values on the box rests on the plant's having one there, as it is written: what holds under a
condition names that one as well, and an input shows no state of a plant that has no value."""

import pytest
import sympy as sp

import hgogen as hg

X1, X2, X3, U, V = (hg.Signal(name, low=-1, high=1) for name in ("x1", "x2", "x3", "u", "v"))
W = hg.Signal("w", low=-2, high=2)
P = hg.Signal("p", nominal=0.5, low=-1, high=1)
Y = hg.Signal("y")
LOST = (U * X1 + U) / U  # x1 + 1, with no value at u = 0
CHOICE = sp.Piecewise((U, U > 0))  # with no value elsewhere


def _plant(*flow: sp.Expr, states: tuple[hg.Signal, ...] = (X1, X2)) -> hg.System:
    read = set().union(*(row.free_symbols for row in flow))
    inputs, parameters = (tuple(s for s in group if s in read) for group in ((U, V), (P,)))
    return hg.System(
        "p", states=states, inputs=inputs, outputs=[Y], parameters=parameters, flow=flow, output=[states[0]]
    )


def _of(checks: tuple[hg.Check, ...], fact: str) -> hg.Check:
    return next(check for check in checks if check.id.fact == fact)


@pytest.mark.ordinary(
    "rest0-u != 0-original",
    "rest0-u != 0-block_triangular",
    "rest1-has a value-original",
    "rest1-has a value-uniform",
    "rest1-has a value-triangular",
    "rest1-has a value-state_affine",
)
@pytest.mark.parametrize("form", ["original", "uniform", "triangular", "state_affine", "block_triangular"])
@pytest.mark.parametrize(("rest", "condition"), [(LOST, "u != 0"), (CHOICE, "has a value")])
def test_a_bound_under_a_condition_asks_for_a_value_of_the_plant_too(form: str, rest: sp.Expr, condition: str) -> None:
    """sqrt(v) bounds no slope at v = 0, and no form reads what the plant has lost at u = 0."""
    check = _of(getattr(hg.forms, form)(_plant(X2 + rest, sp.sqrt(V) * X1)).checks, "lipschitz")
    assert check.verdict == "where"
    assert "v > 0" in str(check.reason)
    assert condition in str(check.reason)


def test_a_bound_under_a_condition_on_inputs_does_not_hold_where_a_state_is_without_a_value() -> None:
    """A condition on the state is none for a bound that is uniform in it."""
    check = _of(hg.forms.original(_plant(X2 + (X1 * X2 + X1) / X1, sp.sqrt(V) * X1)).checks, "lipschitz")
    assert check.verdict == "unknown"


@pytest.fixture
def recast() -> hg.System:
    """x1 - x2 over 2 x1 - 2 x2 has no value at x1 = x2, which the new coordinates lose."""
    plant = _plant(X2, X3 * X2 + (X1 - X2) / (2 * X1 - 2 * X2) + X3, X2, states=(X1, X2, X3))
    return hg.recast(plant, {W: X1 - X2}, {X1: W + X2})


def test_the_singular_set_names_what_new_coordinates_lost(recast: hg.System) -> None:
    """Beside the zeros of the determinant."""
    for check in hg.singularity(recast).checks:
        assert check.verdict == "where"
        assert "w != 0" in str(check.reason)


def test_what_the_first_of_two_recasts_lost_is_asked_for_as_well(recast: hg.System) -> None:
    """The plant in between has lost it."""
    again = hg.Signal("z", low=-4, high=4)
    (w, *_) = recast.states
    for check in hg.singularity(hg.recast(recast, {again: 2 * w}, {w: again / 2})).checks:
        assert check.verdict == "where"
        assert "z != 0" in str(check.reason)


def test_the_inverse_under_a_condition_names_what_new_coordinates_lost(recast: hg.System) -> None:
    """Phi has no value there."""
    check = next(check for check in hg.forms.phase(recast).checks if check.id == "phase.inverse")
    assert check.verdict == "where"
    assert "x2 + 1 != 0 and w != 0" in str(check.reason)


def test_the_outputs_determine_no_state_where_the_last_rate_has_no_value() -> None:
    """y and y' do not read it, and there is no motion there."""
    (check, *_) = hg.singularity(_plant(X2, 1 / X1)).checks
    assert check.verdict == "where"
    assert "x1 != 0" in str(check.reason)


@pytest.mark.parametrize(
    ("rate", "inputs"),
    [((P * X2 + P) / P, None), (X2 + sp.log(P + 1), None), (X2 + 1 / X1, None), (X2 + U + 1 / X1, {"u": 0})],
)
def test_no_input_is_persistent_for_a_plant_without_a_value(rate: sp.Expr, inputs: dict[str, float] | None) -> None:
    """A and C have full rank, whatever the plant has lost."""
    form = hg.forms.state_affine(_plant(rate, -X2))
    accept = [check.id for check in form.checks if check.verdict == "refuted"]
    observer = hg.observers.kalman_like(form, rho=1, R=1, inputs=inputs, accept=accept)
    assert _of(observer.checks, "persistence").verdict == "unknown"


def test_a_plant_with_a_value_keeps_its_persistence() -> None:
    """A logarithm that keeps off 0 asks for nothing."""
    form = hg.forms.state_affine(_plant(X2 + sp.log(P + 2), -X2))
    assert _of(hg.observers.kalman_like(form, rho=1, R=1).checks, "persistence").verdict == "proved"
