"""The generated pages of the site, from the package itself: a page for each observer, form, method and target, the
gallery of the shipped models with their live reports, the Python interface, the command line and the bibliography.
"""

import inspect
import json
import re
import shutil
from collections.abc import Iterator
from functools import cache
from itertools import chain, count
from pathlib import Path
from typing import Any

from typer.testing import CliRunner

import hgogen as hg
from hgogen import registry
from hgogen.cli import app
from hgogen.commands.app import command_of, known
from hgogen.commands.command import meanings
from hgogen.commands.trial_runs import trial_figures, tried
from hgogen.emit.cost import cost
from hgogen.emit.document import claims_table, gains_table, observer_equations
from hgogen.errors import HgogenError
from hgogen.model import Model
from hgogen.modelfiles.place import summary
from hgogen.run import figures

ROOT = Path(__file__).resolve().parents[1]
PAGES = "pages"  # the folder of generated pages, which is not stored
EXAMPLES = ("pendulum", "duffing", "van_der_pol")  # models that show an observer, the first that has a tuning for it
MODELS = sorted(path for path in (ROOT / "models").iterdir() if path.suffix in (".py", ".toml"))


def rows(latex: str) -> list[str]:
    """Return the rows of an equation: those of `aligned`, else the whole."""
    return re.sub(r"\\(begin|end)\{aligned\}", "", latex).strip().split(" \\\\\n")


def write_all(folder: Path) -> None:
    """Write all generated pages into the folder of the site's sources."""
    pages = folder / PAGES
    shutil.rmtree(pages, ignore_errors=True)
    for path, content in chain(cases(), gallery(), interface(), commands(), bibliography()):
        (pages / path).parent.mkdir(parents=True, exist_ok=True)
        (pages / path).write_bytes(content.encode() if isinstance(content, str) else content)


def toctree(names: list[str]) -> str:
    """Return the list of pages below a page."""
    listed = "\n".join(names)
    return f"```{{toctree}}\n:maxdepth: 1\n\n{listed}\n```\n"


# --- observers, forms, methods, targets


def cases() -> Iterator[tuple[str, str | bytes]]:
    """Yield a page for each case of a folder, and their figures."""
    for folder, title in (
        ("observers", "Observers"),
        ("forms", "Forms"),
        ("methods", "Methods"),
        ("targets", "Targets"),
    ):
        names = list(getattr(hg, folder).__all__)
        table = "\n".join(f"| [{name}]({name}.md) | {registry.summary(folder, name)} |" for name in names)
        yield f"{folder}/index.md", f"# {title}\n\n| name | what it is |\n|---|---|\n{table}\n\n{toctree(names)}"
        for name in names:
            case = getattr(getattr(hg, folder), name)
            lines = [f"# {name}", "", registry.summary(folder, name), ""]
            shown = example(name) if folder == "observers" else None
            if shown:
                yield f"{folder}/{name}.svg", shown[1]
                lines += [*when(name), "", shown[0], ""]
            lines += ["## In full", "", signature(f"hg.{folder}.{name}", case), docstring(case), "", *cited(case)]
            yield f"{folder}/{name}.md", "\n".join(lines)


def when(observer: str) -> list[str]:
    """Return the lines that say when to take an observer, from its row in the page of the observers."""
    text = (ROOT / "docs" / "observers.md").read_text(encoding="utf-8")
    cells = next(line for line in text.splitlines() if line.startswith(f"| `{observer}` |")).split(" | ")
    return [f"**Use it if** {cells[1]}.", "", f"**What it requires, and what is proved:** {cells[2]}."]


def docstring(value: Any) -> str:
    """Return a docstring as Markdown, where an indented equation is code already."""
    text = inspect.getdoc(value) or ""
    return re.sub(r"(?<![`\w])<(?=[a-z])", r"\\<", text).replace("*", "\\*") if "\n    " not in text else text


def cited(value: Any) -> list[str]:
    """Return the section of the papers that a docstring cites: by the authors, and the year after them."""
    text = re.sub(r"\b[A-Z]\.(-[A-Z]\.)? ", "", " ".join((inspect.getdoc(value) or "").split()))
    alone = r"(?!, [A-Z][a-z]+,)"  # and not the first of more authors
    keys = [key for key, authors, year in papers() if re.search(rf"\b{authors}\b{alone}.{{0,200}}?\b{year}\b", text)]
    return ["## Literature", "", ", ".join(f"{{cite:t}}`{key}`" for key in keys), ""] if keys else []


def papers() -> Iterator[tuple[str, str, str]]:
    """Yield the key of each paper of the bibliography, its authors' family names as texts join them, and its year."""
    for entry in (ROOT / "docs" / "references.bib").read_text(encoding="utf-8").split("\n@"):
        key, authors, year = re.search(r"{(\w+),\s+author = {(.*?)},\n.*?year = {(\d+)}", entry, re.DOTALL).groups()
        names = (name.split(",")[0].strip("{}") for name in authors.split(" and "))
        yield key, ", ".join(names), year


def signature(name: str, value: Any) -> str:
    """Return the line that calls a function, or nothing for another value; a long one with a parameter in each line."""
    if not callable(value):
        return ""
    try:
        called = inspect.signature(value)
    except (TypeError, ValueError):
        return ""
    parts = [spelled(one) for one in called.parameters.values()]
    first = next((k for k, one in enumerate(called.parameters.values()) if one.kind is one.KEYWORD_ONLY), None)
    if first is not None and not any(one.kind is one.VAR_POSITIONAL for one in called.parameters.values()):
        parts.insert(first, "*")
    returned = called.return_annotation
    end = ")" if returned in (None, called.empty) else f") -> {inspect.formatannotation(returned)}"
    whole = short_types(f"{name}({', '.join(parts)}{end}")
    if len(whole) > 80:
        whole = short_types("\n".join([f"{name}(", *(f"    {part}," for part in parts), end]))
    return f"```python\n{whole}\n```\n"


def spelled(parameter: inspect.Parameter) -> str:
    """Return a parameter with its type, and its default where that is short: a function or a method has no text."""
    if parameter.default is parameter.empty or (
        len(repr(parameter.default)) < 40 and " at 0x" not in repr(parameter.default)
    ):
        return str(parameter)
    return str(parameter.replace(default=...)).replace("Ellipsis", "...")


def short_types(text: str) -> str:
    """Return types without their modules and without the quotes of those that are imported for their names alone."""
    return re.sub(r"\b[a-z_]+(\.[a-z_]+)*\.(?=[A-Zn])|(?<=: )'|(?<=, )'(?=\w+ \|)|'(?= =)|(?<=\])'(?=\])", "", text)


@cache
def loaded(name: str) -> Model:
    """Return a shipped model."""
    return hg.load(str(next(path for path in MODELS if path.stem == name)))


def numbered(text: str, name: str) -> str:
    """Return Markdown whose equations have numbers, as papers have them."""
    labels = (f"$$ ({name}-{k})" for k in count(1))
    return re.sub(r"(?<=\n)\$\$(?=\n\n|$)", lambda _: next(labels), text)


def example(observer: str) -> tuple[str, bytes] | None:
    """Return the page of an observer's example and its figure: its equations, gains, cost, claims and trial."""
    for name in (*EXAMPLES, *(path.stem for path in MODELS)):
        model = loaded(name)
        if not model.has("trial"):
            continue
        try:
            step = model.step(None if model.has("step") and model.step(None).observer.name == observer else observer)
        except HgogenError:
            continue
        if step.observer.name != observer:
            continue
        trial = model.trials()[0]
        done = tried(step, trial, "c", trial.seeds[:1], lambda: None)
        figure = next(iter(trial_figures(step, [done]).values()))
        operations = cost(step, "float")
        lines = [
            f"## On an example: {name}",
            "",
            f"{summary(model.path)}. `hgogen build {name} --observer {observer}` tries it.",
            "",
            f"![{observer} on {name}]({observer}.svg){{.figure}}",
            "",
            numbered("\n".join(observer_equations(step.observer)[2:]), observer),
            "",
            f"Cost: up to {operations.operations} operations and {operations.functions} functions a call, "
            f"{operations.state} bytes of state in float.",
            "",
            *gains_table(step),
            "",
            "What is proved of it, on the declared ranges:",
            "",
            *claims_table(step.observer.checks, step.observer.accepted),
        ]
        return "\n".join(lines), figures.svg(figure).encode()
    return None


# --- the gallery


def gallery() -> Iterator[tuple[str, str | bytes]]:
    """Yield the gallery of the shipped models, with the live report of each that has an observer."""
    cards = []
    for path in MODELS:
        name, folder = path.stem, ROOT / "generated" / path.stem
        drawn = sorted(folder.glob("*_states.svg"))
        if not drawn:
            continue
        yield f"gallery/{name}.svg", drawn[0].read_bytes()
        report = ROOT / "build" / "reports" / f"{name}.html"
        done = CliRunner().invoke(app, ["report", str(path), "--out", str(report)])
        if done.exit_code:
            raise RuntimeError(done.output)
        yield f"extra/reports/{name}.html", report.read_bytes()
        costs = json.loads((folder / "cost.json").read_text()) if (folder / "cost.json").exists() else {}
        spent = f"{costs['nominal_instructions']} instructions, {costs['flash_bytes']} bytes of flash" if costs else ""
        cards += [
            f":::{{grid-item-card}} {name}",
            f":img-top: {name}.svg",
            "",
            f"{summary(str(path))}.",
            "",
            f'{spent}. <a href="../../reports/{name}.html">Live report</a>',
            ":::",
        ]
    lines = ["# Gallery", "", "The models that come with hgogen, each by the figure of its generated C.", ""]
    yield "gallery/index.md", "\n".join([*lines, "::::{grid} 1 2 2 3", ":gutter: 3", "", *cards, "::::", ""])


# --- the Python interface and the command line


def interface() -> Iterator[tuple[str, str | bytes]]:
    """Yield the page of the public names of the package."""
    lines = ["# Python interface", "", "The names of `import hgogen as hg`. Cases have pages of their own.", ""]
    for name in sorted(hg.__all__, key=str.lower):
        value = getattr(hg, name)
        if inspect.ismodule(value):
            continue
        lines += [f"## hg.{name}", "", signature(f"hg.{name}", value), docstring(value), ""]
        for member, method in sorted(vars(value).items()) if inspect.isclass(value) else ():
            if not member.startswith("_") and inspect.isfunction(method) and method.__doc__:
                lines += [f"### {name}.{member}", "", signature(member, method), docstring(method), ""]
    yield "interface.md", "\n".join(lines)


def commands() -> Iterator[tuple[str, str | bytes]]:
    """Yield a page for the commands: the help of each, and the keys of its JSON."""
    lines = ["# Commands in full", ""]
    for name in known():
        done = CliRunner().invoke(app, [name, "--help"], env={"COLUMNS": "100", "NO_COLOR": "1", "TERM": "dumb"})
        lines += [f"## hgogen {name}", "", "```text", done.stdout.strip("\n"), "```", ""]
        for report in vars(command_of(name)).get("reports", ()):
            keys = [f"| `{one.name}` | {one.kind} | {one.text} |" for one in meanings(report)]
            lines += [
                "JSON:",
                "",
                "| key | type | meaning |",
                "|---|---|---|",
                *(key.replace("\n", " ") for key in keys),
                "",
            ]
    yield "commands.md", "\n".join(lines)


def bibliography() -> Iterator[tuple[str, str | bytes]]:
    """Yield the page of all papers."""
    yield "bibliography.md", "# Bibliography\n\n```{bibliography}\n:all:\n```\n"
