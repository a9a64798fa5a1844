"""An observer and its plant as WebAssembly: the emitted C compiled for a browser.

The observer is the C of the firmware, in its precision. The plant is integrated by classical Runge-Kutta in double,
from the right-hand side that the trials use. `Live.cells` names the numbers that both exchange with a page.
"""

import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cache
from importlib.resources import files
from importlib.util import find_spec
from pathlib import Path
from string import Template

import casadi as ca

from hgogen.emit.code import indented
from hgogen.emit.interface import address, assigned, parameters, prototypes, structs
from hgogen.emit.naming import c_name
from hgogen.errors import HgogenError
from hgogen.program import Field
from hgogen.run import native
from hgogen.signal import Signal
from hgogen.step import Step
from hgogen.target import write

FLAGS = (
    *("-std=c99", "-O2", "-w", "-ffp-contract=off", "-ffreestanding", "-fno-math-errno", "-nostdlib", "-I."),
    *("-Wl,--no-entry", "-Wl,--strip-all"),
)
INSTALL = "apt install clang lld, or pip install ziglang"


@dataclass(eq=False)
class NoWebAssembly(HgogenError):
    """The error for a missing or failing compiler for WebAssembly; `reason`: which of the two."""

    text = "there is no observer as WebAssembly: {reason}"
    reason: str


@dataclass(frozen=True)
class Slider:
    """A number that a user of the page may change: its name, range, value, unit and meaning."""

    name: str
    low: float
    high: float
    value: float
    unit: str = ""
    meaning: str = ""


@dataclass(frozen=True)
class Live:
    """An observer with its plant, compiled to WebAssembly (`wasm`), and the numbers that it exchanges with the page, in
    order: the names of `cells` with their counts; the sliders of the plant's parameters and of the observer's gains."""

    wasm: bytes
    cells: Mapping[str, int]
    plant: tuple[Slider, ...]
    gains: tuple[Slider, ...]


def compiler() -> tuple[str, ...] | None:
    """Return the command of the compiler for WebAssembly: clang if wasm-ld is installed, else that of Python's package
    ziglang; None without one."""
    clang = shutil.which("clang")
    if clang and (shutil.which("wasm-ld") or _linker(clang)):
        return clang, "--target=wasm32"
    if find_spec("ziglang"):
        return sys.executable, "-m", "ziglang", "cc", "-target", "wasm32-freestanding"
    return None


@cache
def _linker(clang: str) -> bool:
    """Return whether clang finds a linker for WebAssembly of its own version."""
    command = [clang, "--target=wasm32", "-print-prog-name=wasm-ld"]
    return shutil.which(subprocess.run(command, capture_output=True, text=True, check=False).stdout.strip()) is not None


def live(step: Step, truth: ca.Function, free: tuple[Signal, ...], sources: Mapping[str, str]) -> Live:
    """Return an observer with its plant, compiled for a browser.

    Args: `truth` the plant as a function (x, t, p) -> (x', y, u), p the values of the parameters `free`; `sources` the
    files of the target c99 with their self-check.

    Raises: `NoWebAssembly` without a compiler, or if it fails.
    """
    command = compiler()
    if command is None:
        raise NoWebAssembly(f"it needs clang with wasm-ld, or Python's package ziglang: {INSTALL}")
    tuned = ((kind, item) for kind, fields in parameters(step) if kind != "derived" for item in fields)
    gains = tuple(slider for kind, item in tuned for slider in _sliders(kind, item))
    texts = {name: text for name, text in sources.items() if name.endswith((".c", ".h"))}
    names = (*(name for name in texts if name.endswith(".c")), "live.c")
    with tempfile.TemporaryDirectory() as folder:
        write({**texts, "live.c": _source(step, truth, gains), "math.h": template("math.h")}, folder)
        exact = f"-D{step.name.upper()}_EXACT"
        native.run(
            [*command, *FLAGS, exact, *names, "-o", "live.wasm"],
            folder,
            lambda failed, output: NoWebAssembly(f"{' '.join(failed)} failed: {output.rstrip()}"),
        )
        wasm = (Path(folder) / "live.wasm").read_bytes()
    outputs, inputs = len(step.outputs), truth.size1_out(2)
    cells = {"x": truth.size1_in(0), "y": outputs, "u": inputs + 1, "p": len(free) + 1}
    cells |= {"given": len(step.given) + 1, "samples": len(step.samples), "estimate": len(step.states)}
    plant = tuple(Slider(p.name, *_range(p), float(p.nominal or 0), p.unit, p.meaning) for p in free)
    return Live(wasm, cells | {"gains": len(gains) + 1}, plant, tuple(slider for _, slider in gains))


@cache
def template(name: str) -> str:
    """Return the text of a file that is part of the report's page."""
    return files("hgogen.extras").joinpath("report", name).read_text(encoding="utf-8")


def _range(p: Signal) -> tuple[float, float]:
    """Return the declared range of a parameter, without one half to one and a half times its nominal value."""
    value = float(p.nominal or 0)
    return p.interval if p.bounded else (min(0.5 * value, 1.5 * value), max(0.5 * value, 1.5 * value))


def _sliders(kind: str, item: Field) -> Iterator[tuple[str, Slider]]:
    """Yield the C place and the slider of each element of a parameter of this kind (plant or gain)."""
    for i, (value, (low, high)) in enumerate(zip(item.initial, item.box, strict=True)):
        several = item.size > 1
        name = f"{item.name}[{item.labels[i] if item.labels else i}]" if several else item.name
        place = f"p.{kind}.{c_name(item.name) if kind == 'plant' else item.name}{f'[{i}]' * several}"
        limits = max(low, min(value / 10, value * 10)), min(high, max(value / 10, value * 10))
        yield place, Slider(name, *limits, value, item.unit, item.meaning)


def _source(step: Step, truth: ca.Function, gains: tuple[tuple[str, Slider], ...]) -> str:
    declared, generator = prototypes(step), ca.CodeGenerator("truth", {"with_header": False})
    generator.add(truth)
    inner = [each for each in structs(step) if each.name in ("in", "measurement")]
    cells = {"in": "given", "measurement": "samples"}
    count, filled = dict.fromkeys(cells, 0), []
    for struct, signal in assigned(step):
        filled.append(f"{struct}.{c_name(signal.name)} = cells.{cells[struct]}[{count[struct]}];")
        count[struct] += 1
    written = [f"{place} = cells.gains[{i}];" for i, (place, _) in enumerate(gains)]
    read = [f"cells.estimate[{i}] = x.{c_name(signal.name)};" for i, signal in enumerate(step.states)]
    read += [f"cells.gains[{i}] = {place};" for i, (place, _) in enumerate(gains)]

    return Template(template("live.c")).substitute(
        name=step.name,
        truth=generator.dump(),
        states=truth.size1_in(0),
        outputs=truth.size1_out(1),
        inputs=truth.size1_out(2),
        parameters=truth.size1_in(2),
        given=len(step.given),
        samples=len(step.samples),
        estimated=len(step.states),
        gains=len(gains),
        work=max(1, truth.sz_w()),
        arguments=max(3, truth.sz_arg()),
        results=max(3, truth.sz_res()),
        discrete=int(step.observer.form.system.discrete),
        locals="\n".join(indented(each.local for each in inner)),
        filled="\n".join(indented(filled)),
        written="\n".join(indented(written)),
        read="\n".join(indented(read)),
        estimate=declared["estimate"].call(address),
        tune=declared["tune"].call(address),
        init=declared["init"].call(address),
        step=declared["step"].call(address),
    )
