"""The folder of a step for ecosystems, as ecosystems.toml defines them: its C in src/, an example, a README, and the
files of each ecosystem.
"""

import re
import tomllib
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from functools import cache
from importlib.resources import files
from string import Template
from typing import Any

from hgogen.emit.code import folded, indented
from hgogen.emit.interface import address, assigned, of_signal, parameters, prototypes, status_type, structs
from hgogen.emit.manual import marks
from hgogen.emit.naming import c_name
from hgogen.emit.structs import described
from hgogen.emit.syntax import Real
from hgogen.emit.syntaxes import C, comment
from hgogen.errors import BadArgument, HgogenError, nearest
from hgogen.extras.costs import cost_table
from hgogen.registry import version
from hgogen.signal import Signal, resting, seconds
from hgogen.step import Step
from hgogen.target import Files

ALL = "all"


class UnknownEcosystem(BadArgument):
    """The error for an unknown ecosystem of firmware projects."""


@dataclass(eq=False)
class ReservedName(HgogenError):
    """The error for a step's name that an ecosystem of firmware projects reserves."""

    text = "the name {name} is {ecosystem}'s own; take another by --name"
    name: str
    ecosystem: str


class Text(Template):
    """A text template whose placeholders begin with a percent sign, since CMake uses the dollar sign."""

    delimiter = "%"


@dataclass(frozen=True)
class Ecosystem:
    """An ecosystem of firmware projects, such as Arduino. `files`: the name of the template for each path; `use`: text
    on how a project includes the folder; `reserved`: names that a step may not have."""

    name: str
    files: Mapping[str, str]
    title: str = ""
    use: str = ""
    reserved: tuple[str, ...] = ()


@cache
def _table() -> Mapping[str, Ecosystem]:
    rows = tomllib.loads(files("hgogen.extras").joinpath("ecosystems.toml").read_text(encoding="utf-8"))
    return {name: Ecosystem(name, **{**row, "reserved": tuple(row.get("reserved", ()))}) for name, row in rows.items()}


@cache
def template(name: str) -> Text:
    """Return the template with this name, for a file in a step's folder."""
    path = files("hgogen.extras").joinpath("templates", name)
    return Text(path.read_text(encoding="utf-8"))


def common() -> Ecosystem:
    """Return the files that every step's folder has, as an `Ecosystem`."""
    return _table()["common"]


def known() -> list[str]:
    """Return the names of all ecosystems of firmware projects."""
    return [name for name in _table() if name != "common"]


def chosen(words: str, name: str) -> tuple[Ecosystem, ...]:
    """Return the ecosystems of firmware projects named in `words`, separated by commas, or all for "all"; `name`: the
    step's.

    Raises: `UnknownEcosystem`, `ReservedName` for a step's name that an ecosystem reserves.
    """
    names = [word.strip() for word in words.split(",")]
    for word in names:
        if word not in (*known(), ALL):
            fix = nearest(word, (*known(), ALL), f"there are {', '.join(known())}, and all")
            raise UnknownEcosystem(f"--for {word[:60]}:", f"there is no such ecosystem; {fix}")
    picked = tuple(_table()[word] for word in known() if word in names or ALL in names)
    for each in picked:
        if name.lower() in each.reserved:
            raise ReservedName(name, each.title)
    return picked


SOURCES = "src"
_BY_PARTS = Text(
    "\nWhere a sample comes later than the input, or not in every period, call the parts of a step: %parts.\n"
    "The header says how."
)
_PRINTED_STATUS = {  # the C++ with which a sketch prints a status, by its bytes
    4: ("Serial.print(status, HEX);",),
    8: (
        "Serial.print((unsigned long)(status >> 32), HEX);",
        "Serial.print(' '); /* then the lower 32 bits */",
        "Serial.print((unsigned long)(status & 0xFFFFFFFFu), HEX);",
    ),
}


def folder(
    step: Step,
    sources: Mapping[str, str],
    ecosystems: Iterable[Ecosystem],
    *,
    real: Real = "float",
    costs: Mapping[str, Any] | None = None,
) -> Files:
    """Return by path the files of a step's folder for projects of the ecosystems; `sources`: the files of the targets
    c99 and markdown; `costs`: as `hgogen cost` writes them, ignored if they belong to another source."""
    ecosystems = tuple(ecosystems)
    values = _values(step, real) | {"costs": cost_table(costs, sources[f"{step.name}.c"])}
    values["uses"] = "\n".join(f"## {each.title}\n\n{Text(each.use).substitute(values)}" for each in ecosystems)
    texts = {f"{SOURCES}/{name}" if name.endswith((".c", ".h")) else name: text for name, text in sources.items()}
    for each in (common(), *ecosystems):
        for path, name in each.files.items():
            text = template(name).substitute(values)
            if path.endswith(".c"):  # fold long lines
                text = "\n".join(folded(text.splitlines())) + "\n"
            texts[Text(path).substitute(values)] = text
    return Files(tuple(texts.items()))


def _values(step: Step, real: Real) -> dict[str, Any]:
    declared = prototypes(step)
    samples = assigned(step)
    parts = (f"`{step.name}_{section.name}`" for section in (*step.code.sections, *step.code.timed))
    called = [each.local for each in structs(step) if each.name not in ("s", "p")]
    called += [f"{struct}.{c_name(s.name)} = read_{s.name}();" for struct, s in samples]
    measured = list[str]()  # a sketch measures here
    for struct, s in samples:
        yours = comment(f"yours: {_description(step, s, real)}".rstrip(": "))
        measured.append(f"{struct}.{c_name(s.name)} = 0; {yours}")
    printed = (f"Serial.print(' '); Serial.print(x.{c_name(s.name)});" for s in step.states)
    used = (f"(void)x.{c_name(s.name)}; {comment(_description(step, s, real))}".rstrip() for s in step.states)
    release = re.match(r"\d+\.\d+\.\d+", version())
    period = (seconds(step.time) or 1.0) * step.dt
    return {
        "name": step.name,
        "upper": step.name.upper(),
        "version": release[0] if release else "0.0.0",
        "sentence": f"{step.observer.name} observer of {step.observer.form.system.name}, generated by hgogen",
        "pace": step.pace,
        **_clock(period),
        "rows": str(max(1, round(1 / period))),
        "status": status_type(step),
        "word": f"{step.layout.word}_t",
        "sketched": "unsigned long" if step.layout.word.itemsize == 4 else f"{step.layout.word}_t",
        "told": "\n".join(indented(_PRINTED_STATUS[step.layout.word.itemsize], 8)),
        "init": declared["init"].call(address),
        "step": declared["step"].call(address),
        "estimate": declared["estimate"].call(address),
        "locals": "\n".join(each.local for each in structs(step)),
        "filled": "\n".join(f"{struct}.{c_name(s.name)} = ...;" for struct, s in samples),
        "order": ", ".join(f"`{each.name}`" for each in declared["step"].parameters),
        "apart": _BY_PARTS.substitute(parts=", ".join(parts)) if step.code.separable else "",
        "marked": " ".join([*marks(step), ""]),
        "members": "\n".join(_members(step, real)),
        "bits": "\n".join(
            _row(f"`{step.name.upper()}_{bit.name}`", bit.meaning, step.action_of(bit)) for bit in step.layout.bits
        ),
        "readers": "\n\n".join(_reader(step, signal, real) for _, signal in samples),
        "called": "\n".join(indented(called)),
        "measured": "\n".join(indented(measured)),
        "printed": "\n".join(indented(printed, 8)),
        "used": "\n".join(indented(used, 12)),
    }


def _clock(seconds_: float) -> dict[str, str]:
    """Return the texts with which an Arduino sketch waits for its period (`seconds_`): a counter of microseconds in 32
    bits wraps around after an hour, so longer periods use milliseconds."""
    clock, rate = ("micros", 1e6) if seconds_ < 1000 else ("millis", 1e3)
    return {"clock": clock, "ticks": str(max(1, round(seconds_ * rate)))}


def _row(*cells: str) -> str:
    texts = (" ".join(cell.replace("|", "\\|").split()) for cell in cells)
    return f"| {' | '.join(texts)} |"


def _members(step: Step, real: Real) -> list[str]:
    signals = (*assigned(step), *(("x", state) for state in step.states))
    rows = [_row(f"`{struct}.{c_name(s.name)}`", _description(step, s, real)) for struct, s in signals]
    for kind, fields in (each for each in parameters(step) if each[0] != "derived"):
        named = (replace(item, name=c_name(item.name), unit=step.unit(item)) for item in fields)
        rows += [_row(f"`p.{kind}.{item.name}`", described(item, real)) for item in named]
    return rows


def _description(step: Step, signal: Signal, real: Real) -> str:
    return described(of_signal(step, signal), real)


def _reader(step: Step, signal: Signal, real: Real) -> str:
    remark = comment(_description(step, signal, real))
    lines = (
        f"static {real} read_{signal.name}(void) {remark}".rstrip(),
        "{",
        f"    return {C.literal(resting(signal), real)};",
        "}",
    )
    return "\n".join(lines)
