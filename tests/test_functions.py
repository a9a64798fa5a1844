"""Functions that people write: built as they are meant, in double and in compiled float, or refused where a plant is
declared, by Python and by text alike, with the form that works."""

from collections.abc import Callable
from itertools import pairwise

import casadi as ca
import mpmath
import numpy as np
import pytest
import sympy as sp

import hgogen as hg
from hgogen.analysis.dynamics import Dynamics
from hgogen.analysis.undefined import undefined_slopes, undefined_values
from hgogen.check import Verdict
from hgogen.model import load
from hgogen.reading.expression import BadExpression, parse
from hgogen.rigor.functions import INSTEAD, MEANING, NAMES, refusal
from hgogen.system import BadSystem

X, Y = hg.Signal("x", low=-2, high=2), hg.Signal("y")
Z = hg.Signal("z", low=-1e6, high=1e6)
THIRD = sp.Rational(1, 3)
mp = mpmath


def sign(x: mpmath.mpf) -> mpmath.mpf:
    return mp.sign(x)


# by the text: the same in SymPy, and in mpmath
BUILT: dict[str, tuple[sp.Expr, Callable[[mpmath.mpf], mpmath.mpf]]] = {
    "Heaviside(x - 1)": (sp.Heaviside(X - 1), lambda x: (1 + sign(x - 1)) / 2),
    "Heaviside(x - 1, 0)": (sp.Heaviside(X - 1, 0), lambda x: mp.mpf(x > 1)),
    "Heaviside(x - 1, 1)": (sp.Heaviside(X - 1, 1), lambda x: mp.mpf(x >= 1)),
    "Heaviside(x - 1, 1/4)": (sp.Heaviside(X - 1, sp.Rational(1, 4)), lambda x: mp.mpf(x > 1) + mp.mpf(x == 1) / 4),
    "sign(x)": (sp.sign(X), sign),
    "sinc(x)": (sp.sinc(X), lambda x: mp.sinc(x)),
    "Mod(x, 7/5)": (sp.Mod(X, sp.Rational(7, 5)), lambda x: x - mp.mpf(7) / 5 * mp.floor(x / (mp.mpf(7) / 5))),
    "Mod(x, -7/5)": (sp.Mod(X, -sp.Rational(7, 5)), lambda x: x + mp.mpf(7) / 5 * mp.floor(-x / (mp.mpf(7) / 5))),
    "Mod(x, 2*pi)": (sp.Mod(X, 2 * sp.pi), lambda x: x - 2 * mp.pi * mp.floor(x / (2 * mp.pi))),
    "frac(x)": (sp.frac(X), lambda x: x - mp.floor(x)),
    "floor(x)": (sp.floor(X), mp.floor),
    "ceiling(x)": (sp.ceiling(X), mp.ceil),
    "max(x, -x/2, 1/3, x**3)": (sp.Max(X, -X / 2, THIRD, X**3), lambda x: max(x, -x / 2, mp.mpf(1) / 3, x**3)),
    "min(x, 1, x**2)": (sp.Min(X, 1, X**2), lambda x: min(x, 1, x**2)),
    "hypot(x, 3, x - 1)": (sp.Matrix([X, 3, X - 1]).norm(), lambda x: mp.sqrt(x**2 + 9 + (x - 1) ** 2)),
    "hypot(x, 2*x)": (sp.sqrt(X**2 + (2 * X) ** 2), lambda x: mp.sqrt(5) * abs(x)),
    "clip(x, -1, 3/4)": (sp.Max(-1, sp.Min(X, sp.Rational(3, 4))), lambda x: max(-1, min(x, mp.mpf(3) / 4))),
    "x - clip(x, -1, 1)": (X - sp.Max(-1, sp.Min(X, 1)), lambda x: x - max(-1, min(x, mp.mpf(1)))),
    "cbrt(x)": (sp.real_root(X, 3), lambda x: sign(x) * mp.cbrt(abs(x))),
    "sign(x)*sqrt(abs(x))": (sp.sign(X) * sp.sqrt(sp.Abs(X)), lambda x: sign(x) * mp.sqrt(abs(x))),
    "x/sqrt(abs(x))": (X / sp.sqrt(sp.Abs(X)), lambda x: sign(x) * mp.sqrt(abs(x))),
    "(1 - x)/sqrt(abs(x - 1))": (
        (1 - X) / sp.sqrt(sp.Abs(X - 1)),
        lambda x: sign(1 - x) * mp.sqrt(abs(x - 1)),
    ),
    "Piecewise((sqrt(x), x > 0), (-sqrt(-x), True))": (
        sp.Piecewise((sp.sqrt(X), X > 0), (-sp.sqrt(-X), True)),
        lambda x: sign(x) * mp.sqrt(abs(x)),
    ),
    "sign(x)*abs(x)**(3/2)": (sp.sign(X) * sp.Abs(X) ** sp.Rational(3, 2), lambda x: x * mp.sqrt(abs(x))),
    "x*abs(x)**(7/10)": (X * sp.Abs(X) ** sp.Rational(7, 10), lambda x: x * abs(x) ** (mp.mpf(7) / 10)),
    "x**3/abs(x)": (X**3 / sp.Abs(X), lambda x: x * abs(x)),
    "max(x, 0)**(3/2)": (sp.Max(X, 0) ** sp.Rational(3, 2), lambda x: max(x, mp.mpf(0)) ** mp.mpf("1.5")),
    "sec(x/2)": (sp.sec(X / 2), lambda x: mp.sec(x / 2)),
    "csc(x + 5)": (sp.csc(X / 8 + 1), lambda x: mp.csc(x / 8 + 1)),
    "cot(x/8 + 1)": (sp.cot(X / 8 + 1), lambda x: mp.cot(x / 8 + 1)),
    "sech(x)": (sp.sech(X), mp.sech),
    "csch(x + 5)": (sp.csch(X + 5), lambda x: mp.csch(x + 5)),
    "coth(x + 5)": (sp.coth(X + 5), lambda x: mp.coth(x + 5)),
    "asec(x + 5)": (sp.asec(X + 5), lambda x: mp.asec(x + 5)),
    "acsc(x + 5)": (sp.acsc(X + 5), lambda x: mp.acsc(x + 5)),
    "asech(x/5 + 1/2)": (sp.asech(X / 5 + sp.Rational(1, 2)), lambda x: mp.asech(x / 5 + mp.mpf("0.5"))),
    "acsch(x + 5)": (sp.acsch(X + 5), lambda x: mp.acsch(x + 5)),
    "acoth(x + 5)": (sp.acoth(X + 5), lambda x: mp.acoth(x + 5)),
    "asinh(x)": (sp.asinh(X), mp.asinh),
    "log(log(x + 5))": (sp.log(sp.log(X + 5)), lambda x: mp.log(mp.log(x + 5))),
    "Abs(x)": (sp.sqrt(sp.re(X) ** 2), abs),
}
BUILT["csc(x/8 + 1)"] = BUILT.pop("csc(x + 5)")
FEW = ("Heaviside(x - 1)", "sinc(x)", "Mod(x, 2*pi)", "cbrt(x)", "x/sqrt(abs(x))", "hypot(x, 3, x - 1)", "frac(x)")
EXACT = np.arange(-8, 9) / 4  # jumps and kinks among them, and the same in float


def plant(rate: sp.Expr) -> hg.System:
    return hg.System("p", states=(X,), outputs=(Y,), flow=[rate], output=[X])


def points(text: str) -> np.ndarray:
    """Exact points, near points, and others; of Mod and frac by a rounded period only these off the jumps."""
    draw = np.random.default_rng().uniform(-2, 2, 20)
    small = 10.0 ** np.arange(-30, -1, 4)
    return np.concatenate([EXACT, small, -small, draw]).astype(np.float32).astype(float)


@pytest.mark.ordinary(*FEW)
@pytest.mark.parametrize("text", BUILT)
def test_both_doors_build_it_as_it_is_meant(text: str) -> None:
    """Values to some units of rounding of the argument and the value, and derivatives off the kinks, by mpmath."""
    python, meant = BUILT[text]
    assert plant(parse(text, {"x": X})).flow == plant(python).flow
    z, none = ca.SX.sym("z", 1), ca.SX(0, 1)
    dynamics = Dynamics(hg.forms.original(plant(python)))
    value, slope = (ca.Function("f", [z], [part]) for part in (dynamics.flow(z, none), dynamics.jacobian(z, none)))
    x = points(text)
    with mpmath.workprec(200):
        wanted = np.array([float(meant(mp.mpf(at))) for at in x])
        calm = [at for at in x if abs(4 * at - round(4 * at)) > 0.02 and abs(at) > 0.01]
        slopes = np.array([float(mp.diff(meant, mp.mpf(at), h=mp.mpf(2) ** -60)) for at in calm])
    assert np.abs([float(value(at)) for at in x] - wanted).max() <= 16 * 2.0**-52
    assert [float(slope(at)) for at in calm] == pytest.approx(slopes, rel=1e-12, abs=1e-12)
    assert np.isfinite([float(slope(at)) for at in x]).all()


@pytest.mark.full
@pytest.mark.parametrize("real", ["float", "double"])
@pytest.mark.parametrize("text", [t if t in FEW else pytest.param(t, marks=pytest.mark.slow) for t in BUILT])
def test_the_compiled_step_computes_it(text: str, real: str) -> None:
    """One step of z' = e(x) by 1 s from 0, the input x held, in compiled C."""
    u = hg.Signal("x", low=-2, high=2)
    one = hg.System("one", states=(Z,), inputs=(u,), outputs=(Y,), flow=[parse(text, {"x": u})], output=[Z])
    observer = hg.observers.riccati(hg.forms.original(one), Q=[1], R=1)
    step = hg.sample(observer, hg.methods.continuous_discrete, dt=1.0, between="hold", real=real)
    x = points(text)
    run = step.run_many(np.repeat(x[:, None, None], 2, axis=1), np.full((len(x), 2, 1), np.nan))
    with mpmath.workprec(200):
        wanted = np.array([float(BUILT[text][1](mp.mpf(at))) for at in x])
    assert np.abs(run.x[:, 1, 0] - wanted).max() <= 64 * (2.0**-23 if real == "float" else 2.0**-52)


REFUSED: dict[str, sp.Expr] = {
    "erf": sp.erf(X),
    "erfc": sp.erfc(X),
    "gamma": sp.gamma(X + 5),
    "factorial": sp.factorial(X + 5),
    "zeta": sp.zeta(X + 5),
    "besselj": sp.besselj(0, X),
    "LambertW": sp.LambertW(X + 3),
    "DiracDelta": sp.DiracDelta(X),
    "acot": sp.acot(X),
    "Derivative": sp.Derivative(sp.sin(X), X, evaluate=False),
    "Integral": sp.Integral(sp.sin(X**2), (X, 0, 1)) * sp.erf(X),
    "Limit": sp.Limit(sp.sin(X) / X, X, 0),
    "KroneckerDelta": sp.KroneckerDelta(X, 1),
    "GoldenRatio": sp.GoldenRatio * X,
    "re": sp.re(sp.Symbol("c")),
    "im": sp.im(sp.Symbol("c")),
    "conjugate": sp.conjugate(sp.Symbol("c")),
    "trunc": sp.Function("trunc")(X),
    "f": sp.Function("f")(X),
    "quux": sp.Function("quux")(X),
}


@pytest.mark.parametrize("name", REFUSED)
def test_both_doors_refuse_it_by_one_sentence(name: str) -> None:
    """Where the plant is declared, with the equation and what to write instead."""
    with pytest.raises(BadSystem) as refused:
        plant(REFUSED[name] + X)
    assert "flow 1" in str(refused.value)
    assert refusal(name) in str(refused.value) or name in ("re", "im", "conjugate")
    with pytest.raises(BadExpression) as text:
        parse(f"x + {name}(x)", {"x": X})
    assert refusal(name) in str(text.value)


def test_the_sentences_name_what_works() -> None:
    assert refusal("quux").startswith("there is no function 'quux'; the functions are Abs, Heaviside, Max")
    assert {"Piecewise", "sqrt", "Heaviside", "hypot", "clip"} <= set(NAMES)
    assert refusal("quux").endswith("give another one by its values, as a table")
    assert refusal("sine") == "there is no function 'sine'; did you mean sin?"
    assert not INSTEAD.keys() & set(NAMES)
    assert all(kind.__name__ in NAMES for kind in MEANING if issubclass(kind, sp.Function))


def test_what_is_not_real_is_refused_where_it_is_declared() -> None:
    for rate in ((-8) ** X, sp.Pow(-8, THIRD) * X, sp.exp(sp.I * X), sp.sqrt(-1 - X**2)):
        with pytest.raises(BadSystem, match=r"flow 1, .* is not finite and real"):
            plant(rate)


def test_a_model_file_is_refused_when_it_is_read(tmp_path) -> None:  # type: ignore[no-untyped-def]
    file = tmp_path / "m.toml"
    file.write_text('name = "m"\nstates.x = {flow = "u - gamma(x)"}\ninputs.u = {}\noutputs.y = {equation = "x"}\n')
    with pytest.raises(hg.HgogenError, match=r"states.x.flow: expression .*no function 'gamma'; it has no portable"):
        load(file)


# --- powers with a slope without bound -----------------------------------------------------------------------

P, U = hg.Signal("p", low=-2, high=2), hg.Signal("u", low=-1, high=1)
ROOTS = {
    "sign(p)*sqrt(abs(p))": lambda p: np.sign(p) * abs(p) ** 0.5,
    "p/sqrt(abs(p))": lambda p: np.sign(p) * abs(p) ** 0.5,
    "Piecewise((sqrt(p), p > 0), (-sqrt(-p), True))": lambda p: np.sign(p) * abs(p) ** 0.5,
    "cbrt(p)": lambda p: np.sign(p) * abs(p) ** (1 / 3),
    "sign(p)*abs(p)**0.7": lambda p: np.sign(p) * abs(p) ** 0.7,
}


def orifice(text: str) -> hg.System:
    return hg.System("orifice", states=(P,), inputs=(U,), outputs=(Y,), flow=[U - parse(text, {"p": P})], output=[P])


def fine(flow: Callable[[float], float], u: np.ndarray, dt: float, pieces: int = 200) -> np.ndarray:
    """p' = u - flow(p) from 0, by 200 steps of classical Runge-Kutta in a period; u is linear between its samples."""
    p, out, h = 0.0, [0.0], dt / pieces
    for first, last in pairwise(u):
        for k in range(pieces):

            def rate(share: float, p: float, k: int = k, first: float = first, last: float = last) -> float:
                return float(first + (last - first) * (k + share) / pieces - flow(p))

            a = rate(0, p)
            b = rate(0.5, p + h / 2 * a)
            c = rate(0.5, p + h / 2 * b)
            p += h / 6 * (a + 2 * b + 2 * c + rate(1, p + h * c))
        out.append(p)
    return np.array(out)


@pytest.mark.ordinary("sign(p)*sqrt(abs(p))")
@pytest.mark.parametrize("text", ROOTS)
def test_a_step_runs_through_zero_in_both_directions(text: str) -> None:
    """Without samples it is the plant as written, to the error of the method where the rate is not smooth, in double
    and in float; with samples the filter follows, and no status bit is set."""
    dt, t = 0.01, np.arange(1000) * 0.01
    u = 0.8 * np.sin(2 * np.pi * t / 4)
    truth = fine(ROOTS[text], u, dt)
    assert (np.diff(np.sign(truth[1:])) != 0).sum() >= 4
    observer = hg.observers.riccati(hg.forms.original(orifice(text)), Q=(0.1,), R=1e-4)
    for real in ("double", "float"):
        step = hg.sample(observer, hg.methods.rk4, dt=dt, real=real)
        assert np.abs(step.run(u=u[:, None], y=np.full((1000, 1), np.nan)).x[:, 0] - truth).max() < 5e-4
        noisy = truth + 0.01 * np.random.default_rng(1).normal(size=1000)
        run = step.run(u=u[:, None], y=noisy[:, None])
        assert np.sqrt(np.mean((run.x[:, 0] - truth)[100:] ** 2)) < 0.005
        assert not np.bitwise_or.reduce(run.status)
    step = hg.sample(observer, hg.methods.rk4, dt=dt)
    still = step.run(u=np.zeros((1000, 1)), y=np.full((1000, 1), np.nan))
    assert np.isfinite(still.x).all()


@pytest.mark.parametrize("text", ROOTS)
def test_its_slope_is_that_of_a_chord_by_zero_and_its_own_elsewhere(text: str) -> None:
    """Below 2^-10 of the largest |p|: 1/512 of the range [-2, 2]."""
    z, u = ca.SX.sym("z", 1), ca.SX.sym("u", 1)
    system = orifice(text)
    slope = ca.Function("slope", [z], [Dynamics(hg.forms.original(system)).jacobian(z, u)])
    end, power = 1 / 512, {"cbrt(p)": 1 / 3, "sign(p)*abs(p)**0.7": 0.7}.get(text, 0.5)
    for p in (0.0, end / 2, -end / 2, end * 0.99, 1e-30, -1e-30):
        assert float(slope(p)) == pytest.approx(-(end ** (power - 1)), rel=1e-12)
    for p in (end * 1.01, 0.1, -0.1, 2.0, -1.5):
        assert float(slope(p)) == pytest.approx(-power * abs(p) ** (power - 1), rel=1e-12)
    (check,) = undefined_slopes(system)
    assert check.verdict is Verdict.WHERE
    assert "the step takes the slope of the chord" in str(check.reason)
    assert undefined_values(system) == ()


@pytest.mark.parametrize(
    "rate", [sp.sign(P) * sp.Abs(P) ** 1.5, P * sp.sqrt(sp.Abs(P)), sp.Max(P, 0) ** sp.Rational(3, 2), P**3 / sp.Abs(P)]
)
def test_a_power_above_one_has_its_own_slope_everywhere(rate: sp.Expr) -> None:
    system = hg.System("smooth", states=(P,), outputs=(Y,), flow=[-rate], output=[P])
    assert undefined_slopes(system) == ()
    z = ca.SX.sym("z", 1)
    slope = ca.Function("slope", [z], [Dynamics(hg.forms.original(system)).jacobian(z, ca.SX(0, 1))])
    assert float(slope(0)) == pytest.approx(0, abs=1e-8)


def test_what_stays_without_bound_is_still_said() -> None:
    """A power below 0 has no value at 0 and a root at the end of its range no slope: neither is limited."""
    h = hg.Signal("h", low=0, high=2)
    for state, rate in ((h, -sp.sqrt(h)), (P, 1 / sp.sqrt(sp.Abs(P))), (P, P / sp.Abs(P))):
        system = hg.System("hollow", states=(state,), outputs=(Y,), flow=[rate], output=[state])
        checks = (*undefined_values(system), *undefined_slopes(system))
        assert [check.verdict for check in checks] == [Verdict.REFUTED]


def test_a_proof_does_not_rest_on_the_limited_slope() -> None:
    """Its Lipschitz constant is that of the plant as written: none is proved."""
    (check,) = (c for c in hg.forms.triangular(orifice("sign(p)*sqrt(abs(p))")).checks if c.id.fact == "lipschitz")
    assert check.verdict is Verdict.UNKNOWN


@pytest.mark.parametrize("text", ["-sqrt(abs(p))", "sqrt(abs(p))", "abs(p)**0.7", "-abs(p)**0.7"])
def test_a_root_of_a_size_is_built_as_it_is(text: str) -> None:
    """It is not Lipschitz, which is no claim about the step: that takes the slope of a chord."""
    form = hg.forms.original(orifice(text))
    (check,) = (c for c in form.checks if c.id.fact == "lipschitz")
    assert check.verdict is Verdict.UNKNOWN
    assert "has no bound towards p = 0" in str(check.reason)
    assert str(check.reason).endswith("; the step takes the slope of a chord there")
    step = hg.sample(hg.observers.riccati(form, Q=[1.0], R=1e-4), hg.methods.rk4, dt=0.01)
    run = step.run(u=np.zeros(50), y=np.linspace(-0.1, 0.1, 50), engine="python")
    assert np.isfinite(run.x).all()
    assert abs(run.x[-1, 0] - 0.1) < 0.05


@pytest.mark.full
def test_a_trial_of_it_can_be_integrated_from_zero() -> None:
    from hgogen.trial import Trial, simulate, t

    trial = Trial("swing", duration=8, start={"p": 0}, estimate={"p": 0}, inputs={"u": sp.sin(t)})
    truth = simulate(orifice("sign(p)*sqrt(abs(p))"), trial, 0.01)
    assert truth.x[:, 0] == pytest.approx(
        fine(ROOTS["p/sqrt(abs(p))"], np.sin(0.01 * np.arange(len(truth.x))), 0.01), abs=2e-5
    )
