"""The report of a model in one page: its observer as WebAssembly, its equations with lines of C, and a browser."""

import json
import math
import re
import shutil
import subprocess
import tempfile
from functools import cache
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import casadi as ca
import numpy as np
import pytest
from plants import CART
from typer.testing import CliRunner
from wasmtime import Func, FuncType, Instance, Module, Store, ValType

from hgogen import targets
from hgogen.call import CallableStep
from hgogen.cli import app
from hgogen.commands import reporting
from hgogen.extras import live as webassembly
from hgogen.extras import page
from hgogen.extras.live import Live, live
from hgogen.model import load
from hgogen.trial import Trial, motion, rows_given, simulate

ROOT = Path(__file__).resolve().parents[1]
WITHOUT_STEP = "sir"
MODELS = sorted(
    path.stem for path in (ROOT / "models").iterdir() if path.suffix in (".py", ".toml") and path.stem != WITHOUT_STEP
)
LARGEST = 300_000  # bytes of a page
BROWSER = shutil.which("chromium") or shutil.which("google-chrome")

needs_webassembly = pytest.mark.skipif(webassembly.compiler() is None, reason="no clang with wasm-ld, no ziglang")


class Page:
    """The observer of a page as its script calls it."""

    def __init__(self, made: Live) -> None:
        self.store, self.made = Store(), made
        module, double = Module(self.store.engine, made.wasm), ValType.f64()
        functions = {"fmin": min, "fmax": max}
        imports = [
            Func(self.store, FuncType([double] * len(each.type.params), [double]), self._function(each.name, functions))
            for each in module.imports
        ]
        self.exports = Instance(self.store, module, imports).exports(self.store)

    def _function(self, name: str | None, functions: dict[str, Any]) -> Any:
        return functions.get(str(name)) or getattr(math, str(name))

    def call(self, name: str, *arguments: Any) -> Any:
        return self.exports[name](self.store, *arguments)

    def cells(self, name: str) -> np.ndarray:
        """The numbers of a name, shared with the observer."""
        names = list(self.made.cells)
        first = sum(self.made.cells[each] for each in names[: names.index(name)])
        memory = self.exports["memory"]
        whole = np.frombuffer(memory.get_buffer_ptr(self.store), np.uint8)
        at = self.call("cells") + 8 * first
        return whole[at : at + 8 * self.made.cells[name]].view(float)


@cache
def compiled(name: str) -> tuple[CallableStep, Trial, Live]:
    model = load(str(ROOT / "models" / name) if "." in name else name)
    step, trial = model.step(None), model.trials()[0]
    free = step.observer.form.system.declared.parameters
    sources = targets.c99(step, real="float")
    return step, trial, live(step, motion(step, trial, free), free, sources)


@needs_webassembly
@pytest.mark.ordinary("van_der_pol")
@pytest.mark.parametrize("name", MODELS)
def test_webassembly_computes_the_bits_of_python(name: str) -> None:
    step, trial, made = compiled(name)
    page = Page(made)
    assert page.call("check") == 0  # the recorded samples, bit for bit
    rows, m = rows_given(step, trial, 60), len(step.given)
    rows[7], rows[20, m:] = np.nan, np.nan
    page.call("begin")
    results = []
    for row in rows:
        page.cells("given")[:m], page.cells("samples")[:] = row[:m], row[m:]
        status = page.call("step")
        results.append([*page.cells("estimate"), status])
    single = load(name).step(None).rebuilt(real="float")
    run = single.run(rows[:, : len(step.inputs)], rows[:, m:], "python")
    assert np.array_equal(results, np.column_stack([run.x, run.status]), equal_nan=True)


@needs_webassembly
@pytest.mark.ordinary("van_der_pol")
@pytest.mark.parametrize("name", ["van_der_pol", "pendulum", "induction_motor", "stribeck", "not_iss", "warm_bearing"])
def test_the_plant_of_the_page_is_that_of_the_trial(name: str) -> None:
    step, trial, made = compiled(name)
    plant, page = step.observer.form.system.declared, Page(made)
    truth = simulate(plant, trial, step.dt)
    parts = page_parts(name)
    page.cells("x")[:] = truth.x[0]
    page.cells("p")[: len(made.plant)] = [each.value for each in made.plant]
    first = min([400, *(int(jump.time / step.dt) for jump in trial.jumps)])
    for k in range(first):
        page.call("look", k * step.dt)
        assert page.cells("u")[: truth.u.shape[1]] == pytest.approx(truth.u[k], rel=1e-9, abs=1e-9)
        page.call("move", k * step.dt, step.dt, parts)
    size = np.abs(truth.x).max(axis=0)
    assert np.abs(page.cells("x") - truth.x[first]) / size == pytest.approx(
        0, abs=2e-6
    )  # 400 of at most 1e-7, mostly far less


def page_parts(name: str) -> int:
    step, trial, made = compiled(name)
    free = step.observer.form.system.declared.parameters
    truth = motion(step, trial, free)
    (course,) = (one.first for one in reporting.run_trials(step, (trial,), "python", 1))
    return page.steps_for_page(truth, course, [each.value for each in made.plant], step.dt)


def test_a_stiff_plant_has_more_steps_of_the_page() -> None:
    x, t, p = ca.SX.sym("x"), ca.SX.sym("t"), ca.SX.sym("p", 0)
    course = SimpleNamespace(truth=SimpleNamespace(x=np.ones((50, 1)), t=np.linspace(0, 1, 50)))

    def steps(rate: float) -> int:
        return page.steps_for_page(ca.Function("truth", [x, t, p], [-rate * (x - ca.sin(t)), x, t]), course, [], 0.01)

    assert [steps(1), steps(100)] == [1, 16]  # of exp(-1) off by exp(-1)/(120 n^4)


def test_two_figures_share_no_id() -> None:
    figure = b'<?xml?>\n<svg><defs><path id="a" d="M 0 0 \nL 1.26 2 \n"/></defs><use xlink:href="#a"/></svg>'
    text = page.svg_figures({"one.svg": figure, "one.png": b"", "two.svg": figure})
    assert re.findall(r'id="([^"]*)"', text)[1:] == ["f0a", "f2a"]
    assert re.findall(r'href="#([^"]*)"', text) == ["f0a", "f2a"]
    assert 'd="m0 0l1.3 2"' in text
    assert re.findall("<figcaption>(.*?)</figcaption>", text) == ["one", "two"]


def test_a_figure_says_what_it_shows_and_of_which_trial() -> None:
    text = page.svg_figures({"free_run_states.svg": b"<svg></svg>", "pulse_errors.svg": b"<svg></svg>"})
    captions = ["States and measurements in the trial free_run", "Errors and their proved bounds in the trial pulse"]
    assert re.findall("<figcaption>(.*?)</figcaption>", text) == captions


@needs_webassembly
def test_gains_are_tuned_and_limited_in_the_page() -> None:
    _, _, made = compiled("van_der_pol")
    page = Page(made)
    page.call("begin")
    (theta,) = made.gains
    assert (theta.low, theta.high) == (1, 5)
    assert (theta.name, theta.value) == ("theta", 5)
    page.cells("gains")[0] = 3
    assert page.call("tune") == 0
    page.cells("gains")[0] = 50
    assert page.call("tune") != 0  # limited to the declared range, which the status says
    assert page.cells("gains")[0] == 5


@cache
def written(name: str) -> str:
    with tempfile.TemporaryDirectory() as folder:
        out = str(Path(folder) / f"{name}.html")
        done = CliRunner().invoke(app, ["report", str(ROOT / "models" / name) if "." in name else name, "-o", out])
        assert done.exit_code == 0, done.output
        return Path(out).read_text(encoding="utf-8")


@pytest.mark.ordinary("van_der_pol")
@pytest.mark.parametrize("name", MODELS)
def test_a_page_is_small_needs_no_network_and_links_to_lines_that_are_there(name: str) -> None:
    text = written(name)
    assert len(text.encode()) <= LARGEST
    places = re.findall(r'(?:src|href)="([^"#][^"]*)"|url\((?!#)([^)]*)\)|@import|fetch\(', text)
    assert not places
    ids = re.findall(r'\bid="?([^"> ]+)', text)
    assert len(ids) == len(set(ids))
    links = re.findall(r'href="#([^"]+)"', text)
    assert set(links) <= set(ids)
    assert any(link.startswith("L") for link in links)
    assert "annotation-xml" not in text
    assert "\\frac" not in text
    assert "msqrt" not in text


@pytest.mark.full
def test_an_equation_leads_to_its_row_of_c() -> None:
    text = written("pendulum")
    plant = text[text.index('id="plant"') : text.index('id="form')]
    code = re.findall(r"<i id=L\d+>(.*?)</i>", text)
    lines = [int(line) for line in re.findall(r'href="#L(\d+)"', plant)]
    assert lines
    assert all(code[line - 1].strip() for line in lines)
    sensorless = written("pmsm_sensorless")
    plant = sensorless[sensorless.index('id="plant"') : sensorless.index('id="form')]
    code = re.findall(r"<i id=L\d+>(.*?)</i>", sensorless)
    rates = [code[int(line) - 1].strip() for line in re.findall(r'href="#L(\d+)">flow', plant)]
    assert [rate[: rate.index("=")].strip() for rate in rates] == [f"dz[{i}]" for i in range(5)]
    guards = [code[int(line) - 1] for line in re.findall(r'href="#L(\d+)">guard', plant)]
    assert len(guards) == 2
    assert "_y_a(" in guards[0]
    assert "_y_b(" in guards[1]


@pytest.mark.parametrize(
    ("latex", "parts"),
    [
        (r"\dot{x_{1}} &= \frac{a}{b}", ["<mfrac>", "<mover>"]),
        (r"\sqrt{x^{2} + 1}", ["<msup>", "<mn>2</mn>"]),
        (r"\left[\begin{matrix}0 & 1\\0 & 0\end{matrix}\right]", ["<mtable>", "<mtd><mn>1</mn></mtd>"]),
        (r"\begin{cases} 1 & \text{for}\: x > 0 \\0 & \text{otherwise} \end{cases}", ["<mtable>", "otherwise"]),
    ],
)
def test_an_equation_is_mathml(latex: str, parts: list[str]) -> None:
    text = page.mathml(latex)
    assert all(part in text for part in parts)
    assert "\\" not in text
    assert ">&<" not in text


def test_without_a_compiler_a_page_says_what_is_missing(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr(webassembly, "compiler", lambda: None)
    out = tmp_path / "a folder" / "page.html"
    done = CliRunner().invoke(app, ["report", "pendulum", "-o", str(out), "--json"])
    assert done.exit_code == 0, done.output
    assert json.loads(done.stdout)["live"] is False
    text = out.read_text(encoding="utf-8")
    assert "pip install ziglang" in text
    assert "<figure>" in text
    assert 'id="state"' not in text
    assert "pip install ziglang" in done.stderr


def test_a_compiler_that_fails_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(webassembly, "compiler", lambda: ("false",))
    with pytest.raises(webassembly.NoWebAssembly, match=r"false .*failed"):
        compiled.__wrapped__("van_der_pol")


def browsed(name: str, script: str, folder: Path) -> str:
    """The page as a browser has it after `script`."""
    path = folder / "page with blanks.html"
    path.write_text(written(name) + f"<script>setTimeout(() => {{ {script} }}, 1500)</script>", encoding="utf-8")
    options = ["--headless", "--no-sandbox", "--disable-gpu", "--virtual-time-budget=4000", "--dump-dom"]
    done = subprocess.run(
        [str(BROWSER), *options, path.as_uri()], capture_output=True, text=True, timeout=120, check=True
    )
    return done.stdout


@needs_webassembly
@pytest.mark.skipif(BROWSER is None, reason="no chromium")
@pytest.mark.full
@pytest.mark.parametrize("name", MODELS)
def test_a_browser_runs_the_observer_of_a_page(name: str, tmp_path: Path) -> None:
    script = (
        "for (let k = 0; k < 300; ++k) { window.hgogen.advance(); }"
        "document.title = [...window.hgogen.cells.estimate].every(Number.isFinite) + ' ' + window.hgogen.calls();"
    )
    shown = browsed(name, script, tmp_path)
    assert 'data-selftest="passed"' in shown
    title = re.search(r"<title>(true|false) (\d+)</title>", shown)
    assert title
    assert title[1] == "true"
    assert int(title[2]) >= 300


@needs_webassembly
@pytest.mark.skipif(BROWSER is None, reason="no chromium")
@pytest.mark.full
def test_a_browser_runs_the_observer_on_a_log(tmp_path: Path) -> None:
    step, trial, _ = compiled("pendulum")
    rows = rows_given(step, trial, 50)
    names = ",".join(signal.name for signal in (*step.given, *step.samples))
    log = "\\n".join([names, *(f"{u!r},{y!r}" for u, y in rows.tolist())])
    shown = browsed("pendulum", f'window.hgogen.replay("log.csv", "{log}");', tmp_path)
    replayed = re.search(r'data-replayed="(\d+) ([^"]*)"', shown)
    run = load("pendulum").step(None).rebuilt(real="float").run(rows[:, :1], rows[:, 1:], "python")
    assert replayed
    assert replayed[1] == "50"
    assert [float(v) for v in replayed[2].split()] == pytest.approx(run.x[-1].tolist(), rel=1e-3)
    german = "\\n".join([names.replace(",", ";"), *(f'{u!r};"{y!r}"'.replace(".", ",") for u, y in rows.tolist())])
    assert f'data-replayed="{replayed[1]} {replayed[2]}"' in browsed(
        "pendulum", f"window.hgogen.replay('log.csv', '{german}');", tmp_path
    )
    ragged = browsed("pendulum", f'window.hgogen.replay("log.csv", "{names}\\n1,2\\n1,5,2,5");', tmp_path)
    assert "row 2 has 4 cells, and the header 2" in ragged
    refused = browsed("pendulum", 'window.hgogen.replay("log.csv", "a,b\\n1,2");', tmp_path)
    assert f"log.csv has no column {names.replace(',', ', ')}; it has a, b" in refused


IRREGULAR = f"""{CART}
[observer]
kind = "riccati"
form = "original"
Q = {{x = 1e-3, v = 1e-2}}
noise = {{y = 0.05}}
dt = [0.001, 0.2]
"""


@needs_webassembly
@pytest.mark.skipif(BROWSER is None, reason="no chromium")
@pytest.mark.full
def test_a_log_of_an_irregular_period_has_times(tmp_path: Path) -> None:
    """In t or in dt, as `Step.run` takes them; without both it is refused."""
    model = tmp_path / "cart.toml"
    model.write_text(IRREGULAR)
    times = 5 + np.array([0, 0.1, 0.15, 0.33, 0.34, 0.5])
    u, y, dt = np.ones(6), np.cos(times), np.diff(times, prepend=times[0])
    run = load(str(model)).step(None).rebuilt(real="float").run(u[:, None], y[:, None], "python", dt=dt)
    for name, column in (("t", times), ("dt", dt)):
        rows = np.column_stack([u, y, column]).tolist()
        log = "\\n".join([f"u,y,{name}", *(",".join(map(repr, row)) for row in rows)])
        page_text = browsed(str(model), f'window.hgogen.replay("log.csv", "{log}");', tmp_path)
        replayed = re.search(r'data-replayed="6 ([^"]*)"', page_text)
        assert replayed
        assert [float(v) for v in replayed[1].split()] == pytest.approx(run.x[-1].tolist(), rel=1e-3)
        assert "6 rows, one call each, over 0.5 s." in page_text
        assert "u, y and t, or dt since the row before, in s" in page_text
    refused = browsed(str(model), 'window.hgogen.replay("log.csv", "u,y\\n1,2");', tmp_path)
    assert "log.csv has no column t or dt" in refused


@needs_webassembly
@pytest.mark.skipif(BROWSER is None, reason="no chromium")
@pytest.mark.full
def test_labels_of_axes_differ_and_have_no_more_digits_than_they_need(tmp_path: Path) -> None:
    axes = {
        "0, 10, false": ["0", "5", "10"],
        "-0.034, 2.2, false": ["0", "1", "2"],
        "1.5700, 1.5716, false": ["1.5700", "1.5705", "1.5710", "1.5715"],
        "-3e6, 3e6, false": ["-2e+6", "0e+0", "2e+6"],
        "0.3010, 0.3424, true": ["2.0", "2.1"],
        "-0.7, 0.6, true": ["0.2", "0.5", "1", "2"],
        "-5.2, 0.3, true": ["1e-5", "0.001", "0.1"],
    }
    script = f"document.title = JSON.stringify([{','.join(f'window.hgogen.ticks({axis})' for axis in axes)}]);"
    title = re.search(r"<title>(.*?)</title>", browsed("van_der_pol", script, tmp_path))
    assert title
    assert [[label for _, label in each] for each in json.loads(title[1])] == list(axes.values())
