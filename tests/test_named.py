"""Gains by the names of what they act on: the order of a mapping and that of the plant's declaration change nothing."""

import json
from collections.abc import Callable, Mapping
from functools import cache
from itertools import permutations
from pathlib import Path
from typing import Any

import emitted
import numpy as np
import pytest
import sympy as sp
from hypothesis import given, settings
from hypothesis import strategies as st
from plants import model, two_outputs

import hgogen as hg
from hgogen.commands.claims import checked
from hgogen.model import load
from hgogen.reading.given import BadGain, BadNames, by_coordinate, in_order
from hgogen.reading.text_model import BadModelFile

MODELS = Path(__file__).resolve().parents[1] / "models"
X1, X2, S1, S2 = (
    hg.Signal(name, "", "", nominal, low=low, high=high)
    for name, nominal, low, high in (("X1", 1, 0.1, 5), ("X2", 0.5, 0.1, 3), ("S1", 2, 0.1, 10), ("S2", 10, 0.5, 40))
)
D = hg.Signal("D", "1/d", "dilution", 0.3, low=0.1, high=0.6)
WANDERS = {"X1": 1e-5, "X2": 1e-5, "S1": 0.05, "S2": 2.0}
UNSURE = {"X1": 0.5, "X2": 0.1, "S1": 0.04, "S2": 1.0}


@cache
def digester(order: tuple[hg.Signal, ...] = (X1, X2, S1, S2)) -> hg.System:
    """Acids and methane from waste, two populations on two substrates, of which the substrates are measured (Bernard
    and others, Biotechnology and Bioengineering 75 (2001), with alpha = 1/2 and round numbers)."""
    one, two = 1.2 * S1 / (7 + S1), 0.74 * S2 / (9 + S2 + S2**2 / 256)
    flow = {
        X1: (one - D / 2) * X1,
        X2: (two - D / 2) * X2,
        S1: D * (10 - S1) - 42 * one * X1 / 10,
        S2: D * (40 - S2) + 116 * one * X1 / 10 - 268 * two * X2 / 10,
    }
    outputs = (hg.Signal("y1"), hg.Signal("y2"))
    rates = [flow[x] for x in order]
    return hg.System("digester", states=order, inputs=(D,), outputs=outputs, flow=rates, output=[S1, S2], time="d")


@cache
def measured() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A record of the digester by small Euler steps: inputs, outputs with noise, and X1."""
    rates = sp.lambdify(((X1, X2, S1, S2), D), digester().flow)
    x, dt, rows = np.array([1.6, 0.8, 1.2, 6.0]), 0.1, []
    u = 0.3 + 0.1 * np.sin(0.2 * np.arange(150))
    for now in u:
        rows.append(x)
        for _ in range(10):
            x = x + dt / 10 * np.array(rates(x, now))
    truth = np.array(rows)
    noise = np.random.default_rng(1).normal(size=(len(u), 2)) * [0.05, 0.2]
    return u, truth[:, 2:] + noise, truth[:, 0]


@cache
def own(order: tuple[hg.Signal, ...]) -> hg.Form:
    return hg.forms.original(digester(order))


def estimated(order: tuple[hg.Signal, ...], **gains: Any) -> hg.call.Run:
    step = hg.sample(hg.observers.riccati(own(order), **gains), dt=0.1)
    u, y, _ = measured()
    return step.run(u=u, y=y, engine="python")


BY_NAME: dict[str, Any] = {"Q": WANDERS, "R": {"y2": 4e-3, "y1": 2.5e-4}, "covariance": UNSURE, "initial": {"X1": 1.0}}


@pytest.mark.full
def test_a_sequence_is_in_the_order_of_the_declared_states() -> None:
    """The form took the measured substrates first, and with them what was meant for the populations."""
    order = (X1, X2, S1, S2)
    assert own(order).to_form == order
    listed = {"Q": [WANDERS[x.name] for x in order], "covariance": [UNSURE[x.name] for x in order]}
    ordered = estimated(order, **{**BY_NAME, "R": (2.5e-4, 4e-3), **listed})
    *_, truth = measured()
    swapped = estimated(order, **{**BY_NAME, "Q": [0.05, 2.0, 1e-5, 1e-5], "covariance": [0.04, 1.0, 0.5, 0.1]})
    rms = [float(np.sqrt(np.mean((run["X1"][75:] - truth[75:]) ** 2))) for run in (ordered, swapped)]
    assert rms[1] > 8 * rms[0]  # 0.089 and 0.008: so the test sees which gain went where
    assert np.array_equal(ordered.x, estimated(order, **BY_NAME).x)


@pytest.mark.full
def test_the_order_of_the_declaration_changes_no_estimate() -> None:
    before, after = (estimated(order, **BY_NAME) for order in ((X1, X2, S1, S2), (S2, X1, S1, X2)))
    for name in WANDERS:  # not to the bit: L D L' of another order rounds otherwise
        np.testing.assert_allclose(after[name], before[name], rtol=1e-9)


def turned(order: tuple[int, ...]) -> hg.System:
    """A chain of three with its states declared in another order."""
    plant = hg.System(
        "chain",
        states=(a := hg.Signal("a", low=-2, high=2), b := hg.Signal("b", low=-3, high=3), c := hg.Signal("c")),
        outputs=(hg.Signal("y"),),
        flow=[b, c - sp.sin(a) - b, -c + a * b],
        output=[a],
    )
    pick: Callable[[Any], list[Any]] = lambda rows: [rows[i] for i in order]  # noqa: E731
    return hg.System(
        "chain", states=pick(plant.states), outputs=plant.outputs, flow=pick(plant.flow), output=plant.output
    )


@pytest.mark.parametrize("order", list(permutations(range(3)))[1:])
def test_a_high_gain_scales_by_the_distance_from_the_output(order: tuple[int, ...]) -> None:
    """In the plant's own coordinates, whatever their order: theta^0, theta^1, theta^2 of a, b, c."""
    gains = {"Q": {"c": 0.1, "a": 0.3, "b": 0.2}, "R": {"y": 0.01}, "theta": 3.0, "initial": {"a": 0.5}}
    runs = []
    for each in ((0, 1, 2), order):
        observer = hg.observers.riccati(hg.forms.original(turned(each)), **gains)
        runs.append(hg.sample(observer, dt=0.05).run(y=np.sin(0.1 * np.arange(40)), engine="python"))
        assert [c.verdict for c in observer.form.checks if c.id == "original.order"] == ["generic"]
    for name in "abc":
        np.testing.assert_allclose(runs[1][name], runs[0][name], rtol=1e-9, atol=1e-12)
    assert ("Delta = diag(1, 1/theta, ..)" in "".join(observer.equations)) == (order == (0, 1, 2))


@cache
def mirrored() -> hg.Form:
    return hg.forms.triangular(load(MODELS / "fitzhugh_nagumo.py").plant)


def filtered(**gains: Any) -> hg.Observer:
    return hg.observers.riccati(mirrored(), **{"R": 1.0, "accept": "triangular.a_2", **gains})


values = st.floats(1e-3, 1e3)


@settings(max_examples=10, deadline=None)
@given(st.permutations(["x1", "x2", "eta"]), st.lists(values, min_size=6, max_size=6))
def test_a_mapping_in_any_order_is_its_sequence(order: list[str], numbers: list[float]) -> None:
    Q, P = (dict(zip(("x1", "x2", "eta"), each, strict=True)) for each in (numbers[:3], numbers[3:]))
    start = {"x1": 0.1, "x2": -0.2, "eta": 0.3}
    listed = filtered(Q=numbers[:3], covariance=numbers[3:], initial=[0.1, -0.2, 0.3])
    named = filtered(
        **{key: {x: value[x] for x in order} for key, value in (("Q", Q), ("covariance", P))}, initial=start
    )
    assert named.gains == listed.gains
    one, other = (observer.parts[0] for observer in (named, listed))
    assert one.z == other.z
    for key in ("covariance", "cap", "factor"):
        assert np.array_equal(getattr(one, key), getattr(other, key))


entries = st.floats(-1, 1)


@given(st.lists(entries, min_size=3, max_size=3), st.permutations(["x1", "x2", "eta"]), st.integers(0, 7))
def test_a_matrix_by_rows_is_of_the_states(off: list[float], order: list[str], upper: int) -> None:
    """z_3 is -eta: what is given of x1 and eta is minus that of x1 and z_3. A pair stands in either row."""
    P = 4 * np.eye(3) + np.array([[0, off[0], off[1]], [off[0], 0, off[2]], [off[1], off[2], 0]])
    rows: dict[str, dict[str, float]] = {name: {name: 4.0} for name in order}
    for k, (a, b) in enumerate((("x1", "x2"), ("x1", "eta"), ("x2", "eta"))):
        one, other = (a, b) if upper >> k & 1 else (b, a)
        rows[one][other] = off[k]
    sign = np.diag([1, 1, -1])
    assert np.array_equal(np.asarray(by_coordinate("Q", rows, mirrored())), sign @ P @ sign)


def test_what_is_no_mapping_is_left_as_it_is() -> None:
    matrix = np.eye(3)
    assert by_coordinate("Q", matrix, mirrored()) is matrix
    assert in_order("R", 0.5, ("y",)) == 0.5


@cache
def moved() -> hg.Form:
    return hg.forms.phase(load(MODELS / "bioreactor.py").plant)


Y2 = r"z2 = a1\*m\*s/\(a2\*m \+ s\) - m\*u"


@pytest.mark.parametrize(
    ("weights", "said"),
    [
        ({"m": 1, "s": 1}, rf"^Q names 's', which is no coordinate of this form \(phase\); in its place give {Y2}$"),
        ({"m": 1}, rf"^Q has no value for {Y2}; give one for each of m, z2$"),
        ({"m": 1, "z1": 1}, "^Q names 'z1', which is m here; name m$"),
        ({"m": 1, "z_2": 1}, "^Q names 'z_2', which is none of the names; did you mean z2[?]$"),
        ({"m": 1, "other": 1}, f"^Q names 'other', which is none of the names; they are m, {Y2}$"),
        ({"m": 1, 2: 1}, "^Q names 2, which is none"),
        ({}, "^Q has no value for m, z2 = "),
        ({"m": {"m": 1}, "z2": 2}, r"^Q of z2 is no row by name, as others are; give \{z2 = 2\}$"),
        ({"m": {"m": 1}, "z2": {"m": 2}}, f"^Q of z2 has no value for {Y2}; give one for each of z2$"),
        ({"m": {"m": 1}, "z2": {"z2": 2, "s": 2}}, "^Q of z2 names 's', which is no coordinate"),
    ],
)
def test_a_name_that_is_no_coordinate_is_refused(weights: Mapping[Any, Any], said: str) -> None:
    with pytest.raises(BadNames, match=said):
        hg.observers.riccati(moved(), Q=weights, R=1)


def test_a_state_that_was_recast_is_refused() -> None:
    form = load(MODELS / "cascaded_tanks.py").step().observer.form
    with pytest.raises(BadNames, match=r"names 'x1', which is no coordinate .*in its place give w = sqrt\(x1\)$"):
        hg.observers.riccati(form, Q={"x1": 1, "x2": 1}, R=1)
    with pytest.raises(BadNames, match=r"^initial names 'w', which is none of the names"):  # that is the plant's own
        hg.observers.riccati(form, Q={"w": 1, "x2": 1}, R=1, initial={"w": 1})


def test_a_signal_stands_for_its_name_and_not_beside_it() -> None:
    x1, x2, eta = mirrored().system.states
    by_signal = filtered(Q={eta: 3, x1: 1, x2: 2}, initial={eta: 0.5})
    assert by_signal.gains == filtered(Q=(1, 2, 3)).gains
    with pytest.raises(BadNames, match=r"^Q names eta twice; give it once$"):
        filtered(Q={eta: 3, "x1": 1, "x2": 2, "eta": 3})


def test_a_state_that_initial_leaves_out_starts_at_its_nominal_value() -> None:
    x = [hg.Signal("a", nominal=0.5, low=-1, high=1), hg.Signal("b", low=0.25, high=1)]
    plant = hg.System("two", states=x, outputs=(hg.Signal("y"),), flow=[x[1], -x[0]], output=[x[0]])
    observer = hg.observers.high_gain(hg.forms.triangular(plant), theta=2, poles=(-1, -1), initial={"b": 0.75})
    assert observer.parts[0].fields[0].initial == (0.5, 0.75)


@pytest.mark.parametrize("bad", ["a", None, float("nan"), -10.0, [1.0]])
def test_a_value_that_is_no_gain_is_refused_by_name_too(bad: Any) -> None:
    with pytest.raises(BadGain, match=r"^Q"):
        filtered(Q={"x1": 1, "x2": 2, "eta": bad})
    with pytest.raises(BadGain, match=r"^Q"):
        filtered(Q={"x1": {"x1": 1}, "x2": {"x2": 1}, "eta": {"x1": bad, "eta": 9}})


# Of outputs


@pytest.mark.full
def test_noises_and_weights_of_outputs_go_by_name() -> None:
    form = hg.forms.original(two_outputs())
    y1, y2 = (y.name for y in form.system.outputs)
    Q = dict.fromkeys(form.names, 1)
    one = hg.observers.riccati(form, Q=Q, R={y2: 0.2, y1: 0.1})
    assert [gain.initial for gain in one.gains if gain.name == "R"] == [(0.1, 0.2)]
    with pytest.raises(BadNames, match=f"^R has no value for {y2}; give one for each of {y1}, {y2}$"):
        hg.observers.hamilton_jacobi(form, Q=Q, R={y1: 0.1})
    with pytest.raises(BadNames, match=r"^R names 'z'"):
        hg.observers.kalman_like(hg.forms.state_affine(model("pendulum")), rho=1, R={"z": 1})
    chain = hg.forms.block_triangular(two_outputs(), "end")
    adaptive = hg.theta.adaptive
    law: dict[str, Any] = {"theta_1": 2.0, "mu": (0.1, 0.2), "rise_time": 0.1, "rate": 1.0}
    ways = [
        hg.observers.riccati(
            chain, Q=[1] * 3, R=1, theta=adaptive(**law, innovation=hg.innovation.staggered(0.4, weights=weights))
        )
        for weights in ({y2: 3.0, y1: 5.0}, (5.0, 3.0))
    ]
    texts = [hg.targets.c99(hg.sample(observer, dt=0.1), check=False)["two.c"] for observer in ways]
    assert texts[0] == texts[1]
    with pytest.raises(BadNames, match=r"^weights has no value for"):
        hg.sample(
            hg.observers.riccati(
                chain, Q=[1] * 3, R=1, theta=adaptive(**law, innovation=hg.innovation.window(0.4, weights={y1: 1}))
            ),
            dt=0.1,
        )


@pytest.mark.full
def test_an_error_system_takes_its_gain_and_storage_by_name() -> None:
    plant = model("pendulum")
    x, v = (s.name for s in plant.states)
    (y,) = (s.name for s in plant.outputs)
    one = hg.error_system(plant, gain=[40, 400])
    assert hg.error_system(plant, gain={v: 400, x: 40}) == one == hg.error_system(plant, {v: {y: 400}, x: {y: 40}})
    P, within = [[14.889, -0.739], [-0.739, 0.111]], {v: 10, x: 1}
    dissipation = hg.dissipation(one, {v: {v: 0.111, f"e_{x}": -0.739}, x: {x: 14.889}}, mu=30, within=within)
    assert dissipation.V == hg.dissipation(one, P, mu=30, within=(1, 10)).V
    assert dissipation.within == hg.dissipation(one, P, mu=30, within={f"e_{x}": 1, v: 10}).within
    for wrong in ({x: 1}, {x: 1, v: 10, "r": 1}, {x: 1, f"e_{x}": 1, v: 10}):
        with pytest.raises(BadNames, match=r"^within"):
            hg.dissipation(one, P, mu=30, within=wrong)
    with pytest.raises(BadNames, match=f"^gain names '{v}s', which is none of the names; did you mean {v}"):
        hg.error_system(plant, gain={x: 1, f"{v}s": 1})


# In plain text


CELL: dict[str, Any] = {
    "name": "three",
    "states": {"iL": {"flow": "-iL + v"}, "v": {"flow": "-iL - v*G"}, "G": {"flow": 0, "low": 0.1, "high": 2}},
    "outputs": {"y": {"equation": "v"}},
    "tuning": {
        "riccati": {
            "form": {"kind": "original", "order": ["v", "G", "iL"]},
            "dt": 0.1,
            "Q": {"G": 3, "iL": 1, "v": 2},
            "R": {"y": 0.1},
            "covariance": {"iL": {"iL": 1, "v": 0.5}, "v": {"v": 1}, "G": {"G": 1}},
            "initial": {"G": 1},
        }
    },
}


def written(path: Path, table: Mapping[str, Any]) -> Path:
    path.write_text(json.dumps(table))
    return path


@pytest.mark.full
def test_a_plain_text_model_sets_order_and_gains_by_name(tmp_path: Path) -> None:
    observer = load(written(tmp_path / "three.json", CELL)).step().observer
    assert observer.form.names == ("v", "G", "iL")
    assert observer.gains[0].initial == (2, 3, 1)
    assert np.array_equal(observer.parts[0].covariance, [[1, 0, 0.5], [0, 1, 0], [0.5, 0, 1]])
    plain = load(MODELS / "battery.toml").step("riccati").observer
    assert dict(zip(plain.form.names, plain.gains[0].initial, strict=True)) == {"soc": 5e-6, "v": 9e-7}


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ('{"iL": 1, "v": 2, "G": 3, "iL": 1}', "the key 'iL' stands twice in one table"),
        ('{"iL": 1, "v": 2}', "tuning.riccati: Q has no value for G; give one for each of v, G, iL"),
        ('{"iL": 1, "v": 2, "g": 3}', "Q names 'g', which is none of the names; did you mean G[?]"),
        ('{"iL": 1, "v": 2, "G": "3"}', "must be a number or an array of numbers"),
    ],
)
def test_a_plain_text_gain_by_wrong_names_is_refused(text: str, said: str, tmp_path: Path) -> None:
    path = written(tmp_path / "three.json", CELL)
    path.write_text(path.read_text().replace(json.dumps(CELL["tuning"]["riccati"]["Q"]), text))
    with pytest.raises(BadModelFile, match=said):
        load(path).step()


def test_an_order_that_is_none_is_refused(tmp_path: Path) -> None:
    for order in (["v", "G"], ["v", "G", "G"], ["v", "G", "il"], "vGi", [1, 2, 3]):
        table = json.loads(json.dumps(CELL))
        table["tuning"]["riccati"]["form"]["order"] = order
        with pytest.raises(BadModelFile, match="must hold each of the states iL, v, G once"):
            load(written(tmp_path / "three.json", table)).step()


# At run time, and in print


def test_gains_are_tuned_by_name() -> None:
    step = hg.sample(filtered(Q=(1, 2, 3)), dt=0.01)
    other = hg.sample(filtered(Q=(1, 2, 3)), dt=0.01)
    assert step.tune(Q={"eta": 6, "x1": 4, "x2": 5}, R={"y": 2}) == other.tune(Q=(4, 5, 6), R=2) == 0
    assert np.array_equal(step(u=0.1, y=1.0).x, other(u=0.1, y=1.0).x)
    with pytest.raises(BadNames, match=r"^Q has no value for x2, eta"):
        step.tune(Q={"x1": 1})


def test_a_matrix_is_printed_whole_beside_its_factor() -> None:
    """The gain is the D of L D L', which is no variance of the state."""
    rows = {"eta": {"x1": 0.5, "eta": 1}, "x1": {"x1": 2}, "x2": {"x2": 3}}
    whole = "{x1: {x1: 2, x2: 0, eta: 0.5}, x2: {x1: 0, x2: 3, eta: 0}, eta: {x1: 0.5, x2: 0, eta: 1}}"
    for make in (hg.observers.riccati, hg.observers.hamilton_jacobi):
        equations = make(mirrored(), Q=rows, R=1, accept="triangular.a_2").equations
        assert f"Q = {whole}; the gain Q is D of its factors" in " ".join(equations)
    assert not any("factors" in line for line in filtered(Q=(1, 2, 3)).equations)


def test_gains_are_printed_beside_their_names(tmp_path: Path) -> None:
    model = load(written(tmp_path / "three.json", CELL))
    claims = checked(model)
    assert "  Q = {v: 2, G: 3, iL: 1}\n  R = 0.1" in "\n".join(map(str, claims.head))
    assert claims.as_dict()["gains"] == {"Q": {"v": 2, "G": 3, "iL": 1}, "R": {"y": 0.1}}
    files = hg.targets.c99(model.step(), check=False)
    assert "| `Q[1]` | 3 | 1e-06 .. 3e+06 | z^2/s | process noise, diagonal factor: G |" in emitted.manual(files)
    assert "Q[3]; /**< process noise, diagonal factor: v, G, iL [" in " ".join(files["three.h"].split())
