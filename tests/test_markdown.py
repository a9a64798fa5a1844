"""NAME.md: every equation is LaTeX, every claim, hypothesis and gain is there, and Markdown reads no mark in words."""

import re
from collections.abc import Callable, Iterator
from functools import cache

import emitted
import plants
import pytest
from matplotlib.mathtext import MathTextParser
from plants import kalman, van_der_pol

import hgogen as hg
from hgogen.emit.formula import formulas
from hgogen.model import load
from hgogen.theorem import rows

ALIGNED = re.compile(r"\\begin\{aligned\}\n(.*?)\n\\end\{aligned\}", re.DOTALL)
OTHER_NAMES = {r"\lt": "<", r"\gt": ">", r"\top": "T", r"\left": "", r"\right": "", "&=": "="}


def document(step: hg.Step) -> str:
    ((name, text),) = hg.targets.markdown(step).items()
    assert name == f"{step.name}.md"
    return text


def cells(text: str, section: str) -> list[list[str]]:
    """The rows of the table of a section, without its head; a mark that is escaped is the mark."""
    body = text.split(f"\n## {section}", 1)[1].split("\n## ", 1)[0]
    lines = [line for line in body.splitlines() if line.startswith("| ")][2:]
    return [[re.sub(r"\\(.)", r"\1", cell) for cell in re.split(r" (?<!\\)\| ", line[2:-2])] for line in lines]


def formulas_of(text: str) -> Iterator[str]:
    for block in re.findall(r"^\$\$\n(.*?)\n\$\$$", text, re.MULTILINE | re.DOTALL):
        inner = ALIGNED.fullmatch(block)
        yield from (line.removesuffix(r" \\") for line in inner[1].splitlines()) if inner else (block,)


def adaptive(**changes: object) -> hg.Step:
    gains = {"mu": (0.1, 0.2), "innovation": hg.innovation.staggered(1.0), **changes}
    return hg.sample(kalman(van_der_pol(), theta=hg.theta.adaptive(2.0, **gains)), dt=0.01)


# --- equations ----------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("line", "latex"),
    [
        ("z' = A z + b(sat z, u)", [r"\dot{z} = A z + b(\operatorname{sat} z, u)"]),
        ("P <- P - K c P, c = dh/dz", [r"P \leftarrow  P - K c P,\quad c = dh/dz"]),
        ("S' = -(A + b*)' S, w_i' = w_(i+1)", [r"\dot{S} = -(A + b^{*})^{\top} S,\quad \dot{w_{i}} = w_{i+1}"]),
        ("xhat_i = sat(v_i' - c_(i-1))", [r"\hat{x}_{i}  = \operatorname{sat}(\dot{v_{i}} - c_{i-1})"]),
        (
            "theta^-(n* - 1), R_theta^-1 <= 1e-05",
            [r"\theta ^{-(n^{*} - 1)},\quad R_{\theta}^{-1} \leq  1 \cdot 10^{-5}"],
        ),
        ("mu 0 below gamma_0; a chain of 2", [r"\mu  0 \text{ below } \gamma_{0}", r"\text{ a chain of } 2"]),
        ("z+ = z + h (1/6 k_1 + k_2)", [r"z^{+} = z + h (\frac{1}{6} k_{1} + k_{2})"]),
    ],
)
def test_a_line_of_equations_is_latex(line: str, latex: list[str]) -> None:
    assert formulas(line) == latex


@cache  # most steps have most of their formulas in common
def demand_formula(formula: str) -> None:
    MathTextParser("path").parse(f"${formula}$")


def demand_readable(text: str) -> None:
    """That another reader of LaTeX takes every formula; it knows neither matrices nor these commands."""
    count = 0
    for formula in formulas_of(text):
        for command, name in OTHER_NAMES.items():
            formula = formula.replace(command, name)
        if r"\begin" not in formula:
            demand_formula(formula)
            count += 1
    assert count > 6


@pytest.mark.ordinary("integrated", "tunable", "x")
@pytest.mark.parametrize("name", emitted.STEPS)
def test_every_formula_is_read(name: str) -> None:
    demand_readable(document(emitted.step(name)))


PENDULUM = load(plants.MODELS / "pendulum.py")


@pytest.mark.parametrize("name", sorted(PENDULUM.tuning.tables))
def test_the_equations_of_every_observer_are_read(name: str) -> None:
    text = document(PENDULUM.step(name))
    demand_readable(text)
    assert "## Observer" in text


@pytest.mark.parametrize("method", hg.methods.__all__)
def test_a_method_has_its_equations(method: str) -> None:
    one = getattr(hg.methods, method)
    assert one.equations
    assert all(formulas(line) for line in one.equations)


def test_a_part_that_its_method_leaves_to_another_has_the_others_equations() -> None:
    form = hg.forms.triangular(plants.chain(2))
    step = hg.sample(hg.observers.high_gain(form, theta=5, poles=(-1, -1)), hg.methods.continuous_discrete, dt=0.01)
    text = document(step).split("## Method")[1]
    assert text.startswith(": classical Runge-Kutta\n")
    assert "k_{4} = f(z + h k_{3})" in text
    assert "P c" not in text


# --- tables -------------------------------------------------------------------------------------------------


@pytest.mark.ordinary("fitzhugh_nagumo", "pendulum", "cascaded_tanks", "two", "bank")
@pytest.mark.parametrize("name", emitted.STEPS)
def test_every_claim_has_its_verdict_and_its_evidence(name: str) -> None:
    step = emitted.step(name)
    table = cells(document(step), "Claims")
    checks = step.observer.checks
    assert [row[1] for row in table] == [f"`{check.id}`" for check in checks]
    assert [row[2] for row in table] == [str(check.claim) for check in checks]
    for row, check in zip(table, checks, strict=True):
        assert row[0].startswith(str(check.verdict))
        assert row[3].startswith(str(check.reason))


@pytest.mark.ordinary("fitzhugh_nagumo", "pendulum", "cascaded_tanks", "two", "bank")
@pytest.mark.parametrize("name", emitted.STEPS)
def test_every_hypothesis_has_its_standing(name: str) -> None:
    """What is open comes first."""
    step = emitted.step(name)
    table = cells(document(step), "Hypotheses of the theorem")
    known = rows(step.observer.theorem, step.observer.checks)
    assert sorted(row[:3] for row in table) == sorted([row.standing, row.claim, str(row.reason)] for row in known)
    proved = [row[0] == "proved" for row in table]
    assert proved == sorted(proved)
    assert not proved[0]


def test_a_hypothesis_that_the_gains_refute_is_told() -> None:
    """mu = 0 up to gamma_0: not by a logistic."""

    def standings(step: hg.Step) -> set[str]:
        return {row[0] for row in cells(document(step), "Hypotheses of the theorem")}

    assert "refuted" in standings(adaptive(mu=hg.theta.logistic(0.1, 100)))
    assert "refuted" not in standings(adaptive())


def test_a_refuted_claim_that_was_accepted_says_what_follows() -> None:
    (row,) = (row for row in cells(document(emitted.step("fitzhugh_nagumo")), "Claims") if "a_2" in row[1])
    assert row[0] == "refuted (accepted by the user)"
    assert "at u = 0; so the observer predicts without correction" in row[3]


def test_gains_have_values_ranges_and_units() -> None:
    table = cells(document(emitted.step("cascaded_tanks")), "Observer")
    assert ["`Q[1]`", "0.0014", "1e-10 .. 1400", "z^2/s", "process noise, diagonal factor: w"] in table
    assert ["`rate`", "0.25", "0 .. 250", "1/s", "lambda, rate at which theta decays to 1"] in table


def test_signals_have_units_and_ranges() -> None:
    table = cells(document(emitted.step("pendulum")), "Plant")
    assert ["`q`", "state", "angle", "rad", "-4 .. 4", ""] in table
    assert ["`a`", "parameter", "gravity over length", "1/s2", "", "19.6"] in table


def marked(system: str = "marked") -> hg.Step:
    """Words that Markdown would read."""
    a, y = hg.Signal("a", "1/s*", "*a* | <b> [c](d) $e$", low=-1, high=1), hg.Signal("y")
    plant = hg.System(system, states=(a,), outputs=(y,), flow=[-a], output=[a])
    return hg.sample(hg.observers.riccati(hg.forms.triangular(plant), Q=[1], R=1), dt=0.01)


def test_markdown_reads_no_mark_in_words() -> None:
    text = document(marked())
    assert r"| `a` | state | \*a\* \| \<b\> \[c\](d) \$e\$ | 1/s\* | -1 .. 1 |  |" in text
    assert cells(text, "Plant")[0][2] == "*a* | <b> [c](d) $e$"


RECAST: dict[str, tuple[Callable[[], hg.Step], bool]] = {
    "recast": (lambda: emitted.step("cascaded_tanks"), True),
    "as declared": (lambda: emitted.step("pendulum"), False),
}


@pytest.mark.parametrize("name", RECAST)
def test_the_plants_state_is_written_out_where_it_is_none_of_the_forms(name: str) -> None:
    make, wanted = RECAST[name]
    text = document(make())
    assert ("The plant's state from it" in text) is wanted
    assert ("In the states" in text) is wanted
