"""The CasADi functions of a step: its values, its differential equation, and what others make of them."""

import json
import re
import shutil
import subprocess
from collections.abc import Callable
from copy import copy
from pathlib import Path
from typing import Any

import casadi as ca
import control
import emitted
import numpy as np
import plants
import pytest
from scipy.integrate import solve_ivp
from test_every_observer import each, record, step

import hgogen as hg
from hgogen.call import CallableStep
from hgogen.discretisation.kernel_graphs import kernel_graph
from hgogen.discretisation.kernels import KERNELS
from hgogen.errors import HgogenError
from hgogen.part import Jump
from hgogen.program import Place, lines_of
from hgogen.reading.given import BadGain, BadNames
from hgogen.step import NoStep, StepTooLong
from hgogen.stepping.discretise import NoEquation
from hgogen.stepping.guards import readings
from hgogen.stepping.machine import Machine
from hgogen.targets.casadi import Functions, NotInCasadi

N = 150
EPS = np.finfo(float).eps
NAN = float("nan")


def plausible(made: CallableStep) -> tuple[np.ndarray, np.ndarray]:
    """A record (N, ..) whose outputs, too where they have no range, are in that of what they read."""
    u, y = (table[:N].copy() for table in record(made))
    for j, (signal, (low, high)) in enumerate(zip(made.outputs, readings(made.observer.form), strict=True)):
        if not signal.bounded and np.isfinite(high - low):
            y[:, j] = (low + high) / 2 + (high - low) / 2 * y[:, j]  # which was in -0.5 .. 0.5
    return u, made.arriving(y)


def faulty(made: CallableStep) -> tuple[np.ndarray, np.ndarray]:
    """A record with missing, absurd and excessive samples and inputs."""
    u, y = plausible(made)
    y[40:45], y[60:70, 0], y[80], y[90, -1], u[50:53], u[85] = NAN, NAN, 1e300, -1e14, NAN, 1e30
    return u, y


def results(f: Functions, u: np.ndarray, y: np.ndarray, start: Any = None) -> list[np.ndarray]:
    """The results (N, ..) of a record, in one call of `mapaccum`: memories, estimates, statuses, each report."""
    start = f.memory.initial if start is None else start
    return [result.full().T for result in f.step.mapaccum(len(y))(start, u.T, y.T, f.p.initial)]


def called(f: Functions, u: np.ndarray, y: np.ndarray, start: Any = None) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The memories (N, ..), estimates (N, n) and statuses (N) of a record."""
    memory, x, status = results(f, u, y, start)[:3]
    return memory, x, status @ 2.0 ** (32 * np.arange(status.shape[1]))  # below 2^53 here


def remembered(made: CallableStep) -> np.ndarray:
    """The memory of a step in the order of the function's."""
    places = made._kept.places
    own = [places[Place("state", field.name)] for field in made.layout.state]
    own += [places[Place(line[-1].name, f.name)] for line in lines_of(made.layout.groups) for f in line[-1].fields]
    return np.concatenate([np.ravel(each) for each in own]).astype(float)


def demand_same_as_run(made: CallableStep) -> None:
    u, y = faulty(made)
    f = hg.targets.casadi(made, bundled=True)
    made.reset()
    run = made.run(u=u, y=y, engine="python", **emitted.elapsed(made))
    u = np.hstack([u, np.full((len(u), 1), made.dt)]) if made.clock.varying else u
    memory, x, status = called(f, u, y)
    assert np.array_equal(status, run.status)
    assert np.array_equal(x, run.x)
    assert np.array_equal(memory[-1], remembered(made))
    reported = dict(zip(f.reports, results(f, u, y)[3:], strict=True))
    columns = {name: reported[key][:, k] for key, vector in f.reports.items() for k, name in enumerate(vector.names)}
    for name, values in run.traces.items():
        mine = columns[name] if name in columns else memory[:, f.memory.index(name)]
        assert np.array_equal(mine, values, equal_nan=name in columns)
    for vector, size in ((f.memory, f.step.numel_in(0)), (f.p, f.step.numel_in(3)), (f.x, f.step.numel_out(1))):
        assert size == len(vector) == len(set(vector.names))


def demand_same_as_machine(made: CallableStep) -> None:
    """Which reads the program block by block, by CasADi's own evaluation: no operation is moved."""
    u, y = faulty(made)
    x, _, status = Machine(made).record(u, y)
    _, mine, flags = called(hg.targets.casadi(made), u, y)
    assert np.array_equal(flags, status)
    assert np.array_equal(mine, x)


# --- the step ---------------------------------------------------------------------------------------------------


@pytest.mark.ordinary("pendulum-cascade", "pendulum-hamilton_jacobi")
@each
def test_the_step_has_the_bits_of_run(model: str, name: str) -> None:
    """With the functions of the C, every estimate, trace, status and at the end the whole memory; with CasADi's own,
    those of the machine."""
    demand_same_as_run(step(model, name))
    demand_same_as_machine(step(model, name))


@pytest.mark.ordinary("pendulum", "bent", "chained")
@pytest.mark.parametrize("name", emitted.STEPS)
def test_loops_kernels_and_banks_have_the_bits_of_run(name: str) -> None:
    demand_same_as_run(emitted.step(name))


def test_its_own_sine_is_near_the_one_of_the_c() -> None:
    """One call of the pendulum from the same memory. Its step reads sin four times, each within 2 ulp of the one of
    CasADi's library and the C's own (within 2 and 1 ulp of the truth, |sin| <= 1): the rate errs by 1.5 EPS 19.6 dt,
    the angle by less, and the sums, at most 8 on the way, are rounded once in another way each."""
    made = step("pendulum", "high_gain")
    memory, *_ = called(hg.targets.casadi(made, bundled=True), *(table[:N] for table in record(made)))
    exact, own = (hg.targets.casadi(made, bundled=bundled).step for bundled in (True, False))
    for row in memory[1:]:
        a, b = (f(row, 0.1, 0.2, 20.0)[0].full()[:2, 0] for f in (exact, own))
        assert (np.abs(a - b) <= 1.5 * EPS * 19.6 * made.dt + 8 * EPS * np.abs(a)).all()


SPOILED = {  # a step, an element of its memory and what it holds, the bit that says so
    "pendulum-lost": ("pendulum", "z[0]", NAN, "RESTARTED"),
    "pendulum-infinite": ("pendulum", "z[1]", np.inf, "RESTARTED"),
    "bank-lost": ("bank", "member[1].z[1]", NAN, "RESTARTED"),
    "bank-far": ("bank", "member[0].z[0]", 1e3, "STATE_LIMITED"),  # that of the first member alone
    "bank-beyond": ("bank", "selected", 7.0, ""),  # a member that there is not
}


@pytest.mark.ordinary("pendulum-lost", "pendulum-infinite", "bank-far", "bank-beyond")
@pytest.mark.parametrize("what", SPOILED)
def test_a_spoiled_memory_is_mended_as_by_run(what: str) -> None:
    name, element, value, bit = SPOILED[what]
    made = copy(emitted.step(name))
    f = hg.targets.casadi(made, bundled=True)
    made.reset()
    u, y = (table[:5] for table in record(made))
    made.run(u=u, y=y)
    start = remembered(made)
    start[f.memory.index(element)] = value
    group, _, field = element.rpartition(".")
    place, *numbers = Place(group.partition("[")[0] or "state", field.partition("[")[0]), *digits(element)
    made._kept.places[place][tuple(numbers) or slice(None)] = value
    run = made.run(u=u, y=y)
    memory, x, status = called(f, u, y, start)
    assert not bit or bit in f.flags(status[0])
    assert np.array_equal(status, run.status)
    assert np.array_equal(x, run.x)
    assert np.array_equal(memory[-1], remembered(made))


def digits(element: str) -> list[int]:
    """The numbers in brackets."""
    return [int(number) for number in re.findall(r"\[(\d+)\]", element)]


def test_parameters_are_limited_as_by_tune() -> None:
    made = copy(emitted.step("tunable"))
    f = hg.targets.casadi(made, bundled=True)
    u, y = faulty(made)
    values = {"plant.R": 7.0, "R": NAN, "Q": [2.0, 3.0]}  # beyond its range, not a number, new
    _, x, status = (r.full().T for r in f.step.mapaccum(N)(f.memory.initial, u.T, y.T, f.p.filled(values)))
    made.reset()
    made._kept.places[Place("plant", "R")][:] = 7.0
    limited = made.tune(R=NAN, Q=[2.0, 3.0])
    run = made.run(u=u, y=y)
    assert f.flags(limited) == ("PARAMETER_LIMITED",)
    assert np.array_equal(status[:, 0], run.status | limited)
    assert np.array_equal(x, run.x)


# --- kernels ----------------------------------------------------------------------------------------------------


def matrices(name: str, n: int, seed: int) -> list[np.ndarray]:
    """Arguments of a kernel: of L, D, noise, caps that some variances exceed, variances of which some are 0, rows of a
    matrix with large powers."""
    rng = np.random.default_rng(seed)
    if name in ("balance", "exponential", "resolvent"):
        x = rng.normal(size=(n, n)) * 10.0 ** rng.integers(-3, 4, n) / 10.0 ** rng.integers(-3, 4, n)[:, None]
        others = {"balance": [np.zeros(n)], "exponential": [np.zeros(n * n)] * 3, "resolvent": [np.zeros(n * n)]}
        return [x.ravel(), *(each.copy() for each in others[name])]
    columns = np.tril(rng.normal(size=(n, n))).T.copy()
    vectors = rng.uniform(0.1, 2, size=(4, n))
    vectors[1] *= 10.0 ** rng.integers(-1, 3)
    count = {"expand": 0, "triangularise": 1, "add": 2, "cap": 2, "renew": 3, "project": 2, "decouple": 2}
    if name == "decouple":
        vectors[1] *= rng.integers(0, 2, n)
    if name in ("correct", "disturb"):
        gain = [np.zeros(n)] * (name == "correct")
        return [columns, vectors[0], vectors[1], vectors[2][:1], *gain]
    return [columns, *vectors[: count[name]]]


@pytest.mark.ordinary("2-cap", "3-add", "5-expand")
@pytest.mark.parametrize("name", KERNELS)
@pytest.mark.parametrize("n", [2, 3, 5])
def test_a_kernel_is_that_of_numbers_bit_for_bit(name: str, n: int) -> None:
    returned = set()
    for seed in range(20):
        arguments = matrices(name, n, seed)
        columns = [each for each in arguments if each.ndim == 2]
        counts = {"triangularise": (1 + seed % n,), "correct": (seed % (n + 1),)}.get(name, ())
        graph = kernel_graph(name, n, tuple(each.size for each in arguments[len(columns) :]), counts)
        *mine, last = (result.full() for result in graph.call([ca.DM(each.T) for each in arguments]))
        with np.errstate(all="ignore"):
            result = KERNELS[name](*arguments, *counts) or 0
        wanted = [each.T if each.ndim == 2 else each[:, None] for each in arguments]
        skipped = 1 if name in ("exponential", "resolvent") else 0  # what is left of X
        same = (np.array_equal(a, b, equal_nan=True) for a, b in zip(mine, wanted, strict=True))
        assert all(list(same)[skipped:])
        assert float(last[0, 0]) == result
        returned.add(bool(result))
    assert len(returned) == (2 if name in ("cap", "renew") else 1)


# --- the differential equation ----------------------------------------------------------------------------------

CLIPPED = {"OUTSIDE_BOX", "STATE_LIMITED", "COVARIANCE_LIMITED"}  # bits with which the state is in its box, or was


def by_euler(made: CallableStep, dt: float) -> CallableStep:
    """The step by Euler's method, at a share of this dt where it is too long for the covariance."""
    try:
        return made.rebuilt(method=hg.methods.euler, dt=dt)
    except StepTooLong:
        return by_euler(made, dt / 8)


@pytest.mark.ordinary("pendulum-iterated_ekf", "pendulum-ukf")
@each
@pytest.mark.filterwarnings("ignore::hgogen.step.StepMayFail")
def test_the_derivative_is_what_euler_adds(model: str, name: str) -> None:
    """z + dt z', one step of Euler's method by the program, but for the rounding of the product and of the sum, in its
    box, at the samples where nothing restarted, was missing or was limited in another way."""
    made = step(model, name)
    none = {"bank": "members restart", **dict.fromkeys(("ukf", "iterated_ekf"), "predicts and corrects at samples")}
    discrete = made.observer.form.system.discrete
    if why := "moves from sample to sample" if discrete else none.get(made.observer.name):
        with pytest.raises(NoEquation, match=why):
            _ = hg.targets.casadi(made).derivative
        return
    slow = by_euler(made, made.dt / 64)
    f = hg.targets.casadi(slow)
    u, y = plausible(slow)
    memory, _, status = called(f, u, y)
    jumped = {*f.held, *(name for part in slow.observer.parts if isinstance(part, Jump) for name in part.flow)}
    names = [e.name for e in f.continuous.entries if e.array not in jumped]
    assert names
    state, following = [[f.memory.index(n) for n in each] for each in (f.continuous.names, names)]
    here = [f.continuous.names.index(name) for name in names]
    low, high = np.array([(entry.low, entry.high) for entry in f.continuous.entries])[here].T
    checked = 0
    for k in range(1, N):
        if {*f.flags(status[k]), *f.flags(status[k - 1])} <= CLIPPED:
            before, now = memory[k - 1][state], memory[k][following]
            rate = f.derivative(before, u[k - 1], y[k - 1], f.p.initial).full()[:, 0]
            size = np.abs(before[here]) + slow.dt * np.abs(rate[here])
            then = np.clip((before + slow.dt * rate)[here], low, high)
            assert (np.abs(now - then) <= 2 * EPS * size).all()
            checked += 1
    assert checked > 10


def pendulum() -> tuple[CallableStep, Functions]:
    made = step("pendulum", "high_gain")
    return made, hg.targets.casadi(made)


SWING, END, AT, TOLERANCE = 4.0, 0.5, np.linspace(0, 0.5, 501), 1e-10


@pytest.mark.full
def test_every_integrator_follows_the_reference() -> None:
    """CasADi's, SciPy's and python-control's. The observer forgets an error of the angle in 1/theta, in which it makes
    theta times as much of the rate: of TOLERANCE at each step, 50 steps of dt in that time and fewer of their own, the
    rates differ by at most 1000 TOLERANCE, twice that between two integrators. The reference, and python-control, have
    y on the line between its samples, off the sine by up to (SWING dt)^2/8, which makes theta times that of the rate.
    Only the reference starts anew at each corner of that line: what python-control errs by as it steps across them is
    no multiple of TOLERANCE, so that it is held to the sine, too.
    """
    made, f = pendulum()
    p, start = f.p.initial, f.continuous.initial
    x, t = ca.MX.sym("x", 2), ca.MX.sym("t")
    tolerance = {"abstol": TOLERANCE, "reltol": TOLERANCE}
    ode = {"x": x, "t": t, "ode": f.derivative(x, 0, ca.sin(SWING * t), p)}
    by_casadi = ca.integrator("flow", "cvodes", ode, 0.0, AT[1:], tolerance)(x0=start)["xf"].full().T

    def rate(t: float, x: np.ndarray) -> np.ndarray:
        return f.derivative(x, 0.0, np.sin(SWING * t), p).full()[:, 0]

    by_scipy = solve_ivp(rate, (0, END), start, t_eval=AT[1:], rtol=TOLERANCE, atol=TOLERANCE).y.T
    system = nonlinear(f)
    signals = np.array([0 * AT, np.sin(SWING * AT)])
    by_control = control.input_output_response(
        system, AT, signals, start, solve_ivp_kwargs={"rtol": TOLERANCE, "atol": TOLERANCE}
    )
    made.reset()
    run = hg.reference(made, u=np.zeros((501, 1)), y=np.sin(SWING * AT)[:, None])
    line, rounding = 20 * (SWING * made.dt) ** 2 / 8, 2000 * TOLERANCE
    assert np.abs(by_casadi - by_scipy).max() <= rounding
    assert np.abs(by_scipy - run.x[1:]).max() <= line + rounding
    assert np.abs(by_control.outputs.T[1:] - by_scipy).max() <= line + rounding
    assert list(system.state_labels) == f.continuous.names


def nonlinear(f: Functions) -> Any:
    """The continuous observer as a system of python-control, from (tau, y) to the estimate."""

    def rate(t: float, x: np.ndarray, signals: np.ndarray, parameters: Any) -> np.ndarray:
        return f.derivative(x, signals[:1], signals[1:], f.p.initial).full()[:, 0]

    def shown(t: float, x: np.ndarray, signals: np.ndarray, parameters: Any) -> np.ndarray:
        return f.estimate(x, signals[:1], f.p.initial).full()[:, 0]

    names = {"states": f.continuous.names, "inputs": f.u.names + f.y.names, "outputs": f.x.names}
    return control.nlsys(rate, shown, **names)


@pytest.mark.parametrize("theta", [hg.theta.decaying(4.0, 2.0), None])
def test_theta_moves_as_its_law_has_it(theta: Any) -> None:
    """decaying: theta' = rate (1 - theta); adaptive, of a given innovation: mu theta^2/rise_time + rate (1 - mu)
    (1 - theta), with mu = 1/2 at the middle of a smoothstep, up to theta_1, and (theta - 2 theta_1)^2 above."""
    theta = theta or hg.theta.adaptive(4.0, mu=(0.1, 0.3), innovation=hg.innovation.staggered(1.0), rate=2.0)
    f = hg.targets.casadi(hg.sample(plants.fitzhugh_nagumo(theta=theta), dt=0.01))
    place = f.continuous.index("theta")
    if f.held == ():
        rate = f.derivative(f.continuous.filled({"theta": 3.0}), 0, 0, f.p.initial)
        assert float(rate[place]) == -4.0
        return
    assert f.held == ("innovation",)
    for value, growth in ((3.0, 9.0), (5.0, 9.0)):
        state = f.continuous.filled({"theta": value, "innovation": 0.2})
        rate = f.derivative(state, 0, 0, f.p.initial)
        assert float(rate[place]) == pytest.approx(growth / 2 / 0.1 + 2.0 / 2 * (1 - value), rel=1e-12)


def test_a_missing_sample_predicts() -> None:
    """The rate is that of the model, q' = w, w' = -19.6 sin q - .1 w + tau, and has no slope in y."""
    _, f = pendulum()
    state, slope = [0.3, 0.5], f.derivative.factory("slope", ["state", "u", "y", "p"], ["jac:rate:y"])
    rate = f.derivative(state, 0.2, NAN, f.p.initial).full()[:, 0]
    assert rate == pytest.approx([0.5, -19.6 * np.sin(0.3) - 0.05 + 0.2], rel=1e-14)
    assert np.array_equal(slope(state, 0.2, NAN, f.p.initial).full(), np.zeros((2, 1)))
    assert slope(state, 0.2, 0.1, f.p.initial).full()[:, 0] == pytest.approx([40.0, 400.0])  # 2 theta, theta^2


# --- derivatives ------------------------------------------------------------------------------------------------


@pytest.mark.ordinary("fitzhugh_nagumo", "pendulum")
@pytest.mark.parametrize("name", ["fitzhugh_nagumo", "pendulum", "many_states", "exponential", "bank"])
def test_a_whole_record_can_be_differentiated(name: str) -> None:
    """The last estimate by every gain that is not 0, beside differences of second order, from inside where the gain is
    at the upper end of its range, as a theta is: they err by h^2 times a third derivative, with h = 1e-4 of the gain,
    and by EPS over h, both far below 1e-5 of a slope; of a bank the member that is selected stays the same."""
    made = emitted.step(name)
    f = hg.targets.casadi(made)
    u, y = (table[:60] for table in record(made))
    p = ca.MX.sym("p", len(f.p))
    last = ca.Function("last", [p], [f.step.mapaccum(60)(f.memory.initial, u.T, y.T, p)[1][:, -1]])
    start, slope = f.p.initial, last.jacobian()(f.p.initial, 0).full()
    assert np.isfinite(slope).all()
    for k in np.flatnonzero(start):
        h = 1e-4 * start[k] * np.eye(len(start))[k]
        if f.p.entries[k].high == start[k]:
            difference = 3 * last(start) - 4 * last(start - h) + last(start - 2 * h)
        else:
            difference = last(start + h) - last(start - h)
        assert difference.full()[:, 0] / (2 * h[k]) == pytest.approx(slope[:, k], rel=1e-5, abs=1e-9)
    assert np.abs(slope).max() > 1e-6


def test_the_branch_not_taken_has_no_part_in_a_slope() -> None:
    """sqrt at 0 in the branch of a condition that does not hold: its slope is infinite, and would make it no number."""
    _, f = pendulum()
    slope = f.step.factory("slope", ["state", "u", "y", "p"], ["jac:next:state", "jac:x:y"])
    for y in (0.1, NAN, 1e300):
        assert all(np.isfinite(each.full()).all() for each in slope(f.memory.filled({"calls": 1}), 0.0, y, 20.0))


# --- files ------------------------------------------------------------------------------------------------------


@pytest.mark.ordinary("pendulum", "exponential")
@pytest.mark.skipif(not shutil.which("cc"), reason="no C compiler")
@pytest.mark.parametrize("name", ["pendulum", "bank", "many_states", "exponential"])
def test_casadis_own_c_has_the_bits_of_run(name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    made = emitted.step(name)
    f = hg.targets.casadi(made, bundled=True)
    monkeypatch.chdir(tmp_path)
    code = f.step.generate(f"{name}.c")
    flags = ["-O1", "-ffp-contract=off", "-fPIC", "-shared", "-w", "-o", f"{name}.so", "-lm"]
    subprocess.run(["cc", code, *flags], check=True, timeout=900)
    compiled = ca.external(f.step.name(), f"./{name}.so")
    u, y = faulty(made)
    made.reset()
    run = made.run(u=u, y=y, engine="python", **emitted.elapsed(made))
    u = np.hstack([u, np.full((len(u), 1), made.dt)]) if made.clock.varying else u
    memory = f.memory.initial
    for k in range(N):
        memory, x, status = compiled(memory, u[k], y[k], f.p.initial)
        assert np.array_equal(x.full()[:, 0], run.x[k])
        assert float(status) == run.status[k]


def test_the_files_are_the_functions(tmp_path: Path) -> None:
    made, f = pendulum()
    hg.write(f, tmp_path)
    named = {"step": f.step, "derivative": f.derivative, "estimate": f.estimate}
    assert set(f) == {*(f"pendulum_{name}.casadi" for name in named), "pendulum_entries.json"}
    for name, function in named.items():
        read = ca.Function.deserialize((tmp_path / f"pendulum_{name}.casadi").read_text())
        arguments = [np.linspace(0.1, 0.4, read.numel_in(k)) for k in range(read.n_in())]
        pairs = zip(read.call(arguments), function.call(arguments), strict=True)
        assert all(np.array_equal(a.full(), b.full()) for a, b in pairs)
    entries = json.loads((tmp_path / "pendulum_entries.json").read_text())
    assert [each["name"] for each in entries["continuous"]] == ["z[0]", "z[1]"]
    assert entries["x"][1] == {"name": "w", "initial": 0.0, "unit": "rad/s", "meaning": "rate"}
    assert [each["name"] for each in entries["status"]] == [bit.name for bit in made.layout.raised]
    assert "pendulum_step.casadi" in repr(f)
    assert "bank_derivative.casadi" not in hg.targets.casadi(emitted.step("bank"))


# --- names and sentences ----------------------------------------------------------------------------------------


def test_an_element_has_the_name_of_its_place() -> None:
    f = hg.targets.casadi(emitted.step("bank"))
    assert {"member[2].z[1]", "member[0].score_predictor[2].sum[0]", "selected"} <= set(f.memory.names)
    neuron = hg.targets.casadi(emitted.step("integrated"))
    assert [e.meaning for e in neuron.continuous.entries if e.name == "P[1]"] == [
        "covariance, lower triangle by columns (row 2, column 1)"
    ]


def test_values_are_given_by_name() -> None:
    f = hg.targets.casadi(emitted.step("two"))
    assert f.p.filled({"R": [0.5, 0.6], "Q[1]": 3}).tolist() == [0.1, 3, 0.1, 0.5, 0.6]
    assert f.p.index("R[1]") == 4
    y1, y2 = (output.name for output in emitted.step("two").outputs)
    assert f.p.filled({"R": {y2: 0.6, y1: 0.5}}).tolist()[3:] == [0.5, 0.6]
    assert f.p.initial.tolist() == [0.1] * 4 + [0.2]


REFUSED: dict[str, tuple[Callable[[Functions], Any], type[HgogenError], str]] = {
    "complex": (lambda f: f.p.filled({"R[0]": 1j}), BadGain, "R[0] = 1j must be a number"),
    "complex array": (lambda f: f.p.filled({"R": [1j, 2]}), BadGain, "must be a number or an array of numbers"),
    "text": (lambda f: f.p.filled({"R": "two"}), BadGain, "R = 'two' must be a number or an array of numbers"),
    "unknown": (
        lambda f: f.p.filled({"theta": 3}),
        BadNames,
        "the parameters names 'theta', which is none of the names",
    ),
    "near": (lambda f: f.memory.index("call"), BadNames, "did you mean calls?"),
    "an array's": (lambda f: f.p.index("R"), BadNames, "names 'R', which is an array; name one of its elements"),
    "label": (lambda f: f.p.filled({"R": {"y": 1}}), BadNames, "R names 'y', which is none of the names"),
    "length": (lambda f: f.p.filled({"R": [1, 2, 3]}), BadGain, "R of 3 numbers must have 2"),
    "float": (lambda f: hg.targets.casadi(emitted.step("two"), real="float"), NotInCasadi, 'take "double"'),
    "form": (lambda f: hg.targets.casadi(hg.forms.original(plants.two_outputs())), NoStep, "Form given to casadi"),
}


@pytest.mark.ordinary("complex array", "unknown", "near")
@pytest.mark.parametrize("what", REFUSED)
def test_what_does_not_fit_is_refused_by_a_sentence(what: str) -> None:
    make, error, sentence = REFUSED[what]
    with pytest.raises(error) as caught:
        make(hg.targets.casadi(emitted.step("two")))
    assert sentence in str(caught.value)


def test_a_bank_says_why_it_has_no_derivative() -> None:
    f = hg.targets.casadi(emitted.step("bank"))
    for ask in ("derivative", "estimate", "continuous", "held"):
        with pytest.raises(NoEquation, match="a bank is no differential equation: its members restart"):
            getattr(f, ask)
