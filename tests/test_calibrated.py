"""Parts of tuning and advising by themselves: two outputs, the refinement, the rows held out, and files."""

import math
from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy.stats import gamma

import hgogen as hg
from hgogen.logs import tune
from hgogen.logs.advise import advise
from hgogen.logs.judged import Judged, verdicts
from hgogen.logs.likelihood import MIDDLE, STARTS, Likelihood, Noise
from hgogen.logs.records import Log, quantum_of
from hgogen.logs.tune import FILTER, Search, Tuned, adaptive, search_together, thetas
from hgogen.modelfiles.json_file import BadFile, read_tunings
from hgogen.modelfiles.tuning import First
from hgogen.starting import Scale, Starting, scale, two_digits

DT = 0.1
FIXED = SimpleNamespace(varying=None)  # the clock of a step with one dt


@pytest.fixture
def made_of_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    """Observers and steps of these tests are names, which cost nothing and are taken by every form."""
    monkeypatch.setattr(tune, "observer_on", lambda row, name, gains: None)
    monkeypatch.setattr(tune, "quickest_engine", lambda step, samples: "python")


X, V, W = (hg.Signal(name, low=-5, high=5) for name in "xvw")
Y, Z = hg.Signal("y"), hg.Signal("z")
PAIR = hg.System("pair", states=(X, W), outputs=(Y, Z), flow=[W / 2 - X, X / 3 - W], output=[X, W])
CHAINS = hg.System("chains", states=(X, V, W), outputs=(Y, Z), flow=[V, -X, X - W], output=[X, W])
SPRING = hg.System("spring", states=(X, V), outputs=(Y,), flow=[V, -X], output=[X])


def test_the_likelihood_of_two_outputs_is_that_of_both_at_once() -> None:
    """Sum of e_j^2/s_j + log s_j over the outputs one after the other = r' S^-1 r + log det S of both, to rounding."""
    form = hg.forms.block_triangular(PAIR)
    numbers = scale(form, DT, {})
    y = np.random.default_rng(0).normal(size=(30, 2))
    record = hg.Log(np.zeros((30, 0)), y, DT)
    q, sigma = dict.fromkeys(form.names, 0.3), {"y": 0.4, "z": 0.7}
    e, s = Likelihood(form, (record,), numbers, "hold", 1).innovations(Noise(q, sigma, 0.0, True), record)
    A, eye = DT * np.array([[-1, 1 / 2], [1 / 3, -1]]), np.eye(2)
    Phi = eye + A @ (eye + A / 2 @ (eye + A / 3 @ (eye + A / 4)))  # what classical Runge-Kutta is of a linear plant
    x, P, R = y[0], np.diag([unit**2 / 4 for unit in numbers.states.values()]), np.diag([0.4**2, 0.7**2])
    expected = []
    for sample in y[1:]:
        x, P = Phi @ x, Phi @ P @ Phi.T + 0.3 * DT * eye
        S, r = P + R, sample - x
        expected.append(r @ np.linalg.solve(S, r) + np.log(np.linalg.det(S)))
        gain = P @ np.linalg.inv(S)
        x, P = x + gain @ r, P - gain @ P
    assert (e**2 / s + np.log(s)).sum(axis=1) == pytest.approx(np.array(expected), abs=1e-9)


@pytest.mark.parametrize("wanted", [1.0, 4.0])
@pytest.mark.usefixtures("made_of_nothing")
def test_the_search_is_refined_next_to_the_best(wanted: float) -> None:
    """Half way, in the logarithm, from the best theta of the grid to its two neighbours, then with other shapes; where
    faster poles that differ are better, they are taken."""
    form = hg.forms.triangular(SPRING)
    base = scale(form, 1e-3, {})
    grid = thetas(base.theta, 1e-3)
    best = grid[len(grid) // 2]
    task: Any = SimpleNamespace(
        rows=("a form",),
        dt=1e-3,
        sampling={},
        first=lambda name, row, numbers: First(name, row, Starting({}, 1e-3), numbers),
    )

    def error(numbers: Scale) -> float:
        return np.log(numbers.theta / best) ** 2 + np.log(numbers.spread / wanted) ** 2

    def work(pieces: Iterable[Any]) -> dict[Any, Any]:
        return {piece: np.full(3, error(piece.numbers)) for piece in pieces}

    ((_, tuned),) = search_together({"high_gain": Search(task, "high_gain", 0, base).search()}, work)
    assert tuned is not None
    scales = [numbers for numbers, _ in tuned.tried]
    middle = len(grid) // 2
    beside = [two_digits((best * grid[k]) ** 0.5) for k in (middle - 1, middle + 1)]
    assert [one.theta for one in scales[:-4]] == [*grid, *beside]
    assert [(one.spread, one.theta) for one in scales[-4:]] == [
        (spread, two_digits(factor * best)) for spread in (2, 4) for factor in (1, 1.4)
    ]
    assert (tuned.numbers.spread, tuned.numbers.theta) == (wanted, best)


def tuned(**over: Any) -> Tuned:
    """A filter with theta = 1 whose errors by segment are 4 and 5."""
    row: Any = SimpleNamespace(form="form")
    first = SimpleNamespace(row=row, starting=SimpleNamespace(gains={}), step="plain")
    numbers = SimpleNamespace(n=2, theta=1.0)
    values: dict[str, Any] = {"noise": None, "likelihood": None, "errors": np.array([4.0, 5.0]), **over}
    return Tuned(name=FILTER, first=first, numbers=numbers, sampling={}, tried=(), **values)


def watched(innovation: np.ndarray, tables: list[Any], errors: Any = None) -> Any:
    """A task of a step with these innovations, which keeps the arguments theta that it is asked for."""
    step = SimpleNamespace(
        inputs=(hg.Signal("u"),),
        clock=FIXED,
        reset=lambda time: None,
        run=lambda **record: SimpleNamespace(traces={"innovation": innovation}),
    )

    def made(name: str, row: Any, gains: Any) -> Any:
        tables.append(gains["theta"])
        return SimpleNamespace(step=step)

    return SimpleNamespace(
        dt=DT,
        records=(Log(np.zeros((20, 1)), np.zeros((20, 1)), DT),),
        make_step=made,
        judge=SimpleNamespace(engine="python", errors=errors),
    )


@pytest.mark.usefixtures("made_of_nothing")
def test_an_adaptive_theta_adds_the_errors_that_it_makes() -> None:
    """By segment, to those cross-validated of the filter: what it makes more than the filter does."""

    def errors(step: Any) -> np.ndarray:
        return np.array([1, 3] if step == "plain" else [2.0, 2.5])

    made = adaptive(watched(np.ones(20), [], errors), tuned())
    assert isinstance(made, Tuned)
    assert made.errors.tolist() == [5.0, 4.5]


@pytest.mark.usefixtures("made_of_nothing")
def test_an_alarm_window_is_a_quarter_of_the_time_to_cross_a_range() -> None:
    """d = T/4, T = 2 n/theta: 1 of n = 2 with theta = 1, in whole samples for each of 4 predictors."""
    tables: list[Any] = []
    adaptive(watched(np.ones(20), tables, lambda each: np.zeros(2)), tuned())
    assert tables[0]["innovation"]["d"] == pytest.approx(1.0, abs=2 * DT)


@pytest.mark.usefixtures("made_of_nothing")
def test_an_alarm_that_feeds_itself_is_refused() -> None:
    """With theta at its peak the innovations have a mean of 1.5; the threshold is 1.1 times the largest at rest."""
    tables: list[Any] = []

    def run(**record: Any) -> Any:
        raised = tables[-1]["mu"][0] < 1e-3  # the run with theta at its peak
        return SimpleNamespace(traces={"innovation": np.full(20, 1.5 if raised else 1.0)})

    task = watched(np.ones(20), tables, lambda each: np.zeros(2))
    step = SimpleNamespace(inputs=(hg.Signal("u"),), clock=FIXED, reset=lambda time: None, run=run)
    task.make_step = lambda name, row, gains: (tables.append(gains["theta"]), SimpleNamespace(step=step))[1]
    refusal = adaptive(task, tuned())
    assert isinstance(refusal, str)
    assert "theta does not return to 1, even with theta_1 = 2 (alarm ratio 1.4)" in refusal


def test_the_innovations_of_the_rows_held_out_are_all_counted() -> None:
    """The first innovation is that of row 1: of 10 rows held out from row 4, those of rows 4 to 9."""
    rows = np.arange(1.0, 10.0)[:, None]
    form = SimpleNamespace(system=SimpleNamespace(inputs=()))
    likelihood = SimpleNamespace(form=form, innovations=lambda noise, record: (rows, np.full_like(rows, 2.0)))
    one = tuned(noise=Noise({}, {"y": 1.0}, 0.0, True), likelihood=likelihood)
    record = Log(np.zeros((10, 0)), np.zeros((10, 1)), DT)
    assert one.innovations([(record, 4)])["y"] == pytest.approx(rows[3:, 0] / np.sqrt(2))
    assert one.innovations([(record, 0)])["y"] == pytest.approx(rows[:, 0] / np.sqrt(2))


@pytest.mark.parametrize(("nis", "said"), [(0.49, "less"), (0.51, ""), (1.99, ""), (2.01, "more")])
def test_variances_are_doubted_on_both_sides(nis: float, said: str) -> None:
    best: Any = SimpleNamespace(
        name="riccati", error=0.5, rank=(1, False, 9), noise=None, tried=(), numbers=None, below_quantum={}
    )
    made: Any = SimpleNamespace(best=best, rows=(best,), tied=(best,), ahead=1, truth=(), final=())
    doubts = verdicts(made, [Judged("riccati", {}, {}, {"y": nis})])[1:]
    assert [f"they scatter {said} there" in doubt for doubt in doubts] == [True] * bool(said)


def test_a_wanted_time_is_that_of_the_longest_chain() -> None:
    (row,), _ = advise(CHAINS, dt=1e-3, settling=0.5, observers=["high_gain"])
    assert row.first.step.observer.form.blocks == (2, 1)
    assert row.theta == two_digits(gamma.isf(0.01, 2) / 0.5)


def test_a_tuning_that_is_no_table_is_refused_beside_one_that_is(tmp_path: Path) -> None:
    (tmp_path / "tuned.json").write_text('{"tuning": {"a": {}, "b": 1}}')
    with pytest.raises(BadFile, match='has no table "tuning" of tables'):
        read_tunings(tmp_path / "tuned.json", CHAINS)


def test_the_quantum_is_that_of_which_all_differences_are_multiples() -> None:
    x = 0.1 * np.cumsum(np.random.default_rng(0).normal(size=2000))
    steps = {q: quantum_of(np.round(x / q) * q + 0.013) for q in (0.3, 2e-4, 0.00291447, 1.0)}
    assert [*steps.values()] == pytest.approx([*steps])
    assert quantum_of(np.pi / 180 * np.round(x, 3)) == pytest.approx(np.pi / 180 * 1e-3)
    assert quantum_of(np.array([0.0, 3, 3, 0, 6, 3, 8, 8, 6, 0])) == pytest.approx(
        1.0
    )  # 3, 3 and 2 steps: parts of a gap
    for values in (x, np.full(50, 1.0), np.array([]), np.array([1.0, np.nan]), np.array([0.0, 1.0, 2.0])):
        assert quantum_of(values) == 0.0
    assert quantum_of(np.where(np.arange(2000) % 3, np.round(x, 2), np.nan)) == pytest.approx(0.01)


def test_noise_of_a_sample_is_not_below_that_of_its_steps() -> None:
    """Of a model without the noise that moves the plant the likelihood wants a sensor that is better than its steps;
    a sensor that is as noisy as its steps is no such case."""
    draw, N, q = np.random.default_rng(3), 1000, 0.05
    still = hg.System("still", states=(X,), outputs=(Y,), flow=[-0 * X], output=[X])
    form = hg.forms.original(still)

    def likelihood(y: np.ndarray) -> Likelihood:
        log = hg.Log(np.zeros((N, 0)), (np.round(y / q) * q)[:, None], 0.1)
        return Likelihood(form, (log,), scale(form, 0.1, {}), "hold", 1)

    walk = likelihood(2 * np.sin(0.03 * np.arange(N)))
    best = walk.maxima([walk.ended(MIDDLE)])[0]
    assert q / np.sqrt(12) < best.sample["y"] < 1.03 * q / np.sqrt(12)  # two digits of its square are not below
    assert walk.below_quantum(best) == {"y": best.sample["y"]}
    quiet = likelihood(1.0 + 0.95 * q / np.sqrt(12) * draw.normal(size=N))
    best = quiet.maxima(map(quiet.ended, (*STARTS[:2], MIDDLE)))[0]
    assert quiet.below_quantum(best) == {}
    slow = replace(quiet, scale=replace(quiet.scale, longest=1e4))
    least = math.exp(slow._least[0]) * slow.scale.units["x"] * 0.1  # of Q, in a sample: what float rounds
    assert least == pytest.approx((2.0**-24 * slow.scale.states["x"]) ** 2 / 12, rel=1e-9, abs=0)
