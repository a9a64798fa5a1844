"""The tables of the pages in docs/ that can be computed: `python tests/doc_tables.py` writes them anew.

A table stands between the lines `<!-- table: NAME -->` and `<!-- end -->`. The observers keep the order in which they
stand in the page.
"""

import re
from collections.abc import Callable, Iterable, Mapping
from functools import cache
from importlib import import_module
from pathlib import Path

import hgogen as hg
from hgogen.emit.cost import cost
from hgogen.model import load
from hgogen.registry import summaries
from hgogen.starting import rule

ROOT = Path(__file__).resolve().parents[1]
TABLE = re.compile(r"^<!-- table: (\w+) -->\n(.*?)^<!-- end -->$", re.MULTILINE | re.DOTALL)

Words = Mapping[str, list[str]]  # the cells of each row as they stand, by its first cell


def written(text: str) -> str:
    """A page with its tables as they are now."""
    return TABLE.sub(lambda found: f"<!-- table: {found[1]} -->\n{TABLES[found[1]](words(found[2]))}<!-- end -->", text)


def words(table: str) -> Words:
    """The cells of each row of a table."""
    rows = [[cell.strip() for cell in line.strip("| ").split(" | ")] for line in table.splitlines()]
    return {row[0].strip("`"): row for row in rows}


def table(head: Iterable[str], rows: Iterable[Iterable[str]]) -> str:
    """A table in Markdown."""
    head = list(head)
    lines = [head, ["---"] * len(head), *map(list, rows)]
    return "".join(f"| {' | '.join(line)} |\n" if line[0] != "---" else f"|{'|'.join(line)}|\n" for line in lines)


@cache
def counted(name: str) -> str:
    """Operations and functions of a sample of the pendulum's tuning."""
    one = cost(load(ROOT / "models" / "pendulum.py").step(name))
    return f"{one.operations} + {one.functions}"


def _observers(old: Words) -> str:
    cases = hg.observers.__all__
    order = [*(name for name in old if name in cases), *(name for name in cases if name not in old)]
    said = {name: rule(getattr(hg.observers, name)) for name in cases}
    rows = ((f"`{name}`", said[name].where, said[name].asks, said[name].state, counted(name)) for name in order)
    return table(("observer", "take it where", "what it asks for, or leaves open", "state", "cost"), rows)


def _cases(kind: str) -> Callable[[Words], str]:
    def made(old: Words) -> str:
        told = summaries(f"hgogen.{kind}", getattr(hg, kind).__all__)
        return table((kind.removesuffix("s"), "what it is"), ((f"`{name}`", text) for name, text in told.items()))

    return made


def _folders(old: Words) -> str:
    from test_house import COLUMN  # the order that a test holds them to

    lines = ((f"`{folder}/`", _line(folder)) for folder in COLUMN)
    return table(("folder", "what is in it"), lines)


def _line(folder: str) -> str:
    """The first line of a folder's docstring."""
    text = (import_module(f"hgogen.{folder}").__doc__ or "").partition("\n")[0].rstrip(".")
    return text[:1].lower() + text[1:]


TABLES: Mapping[str, Callable[[Words], str]] = {
    "observers": _observers,
    "forms": _cases("forms"),
    "methods": _cases("methods"),
    "folders": _folders,
}


def main() -> None:
    """Write the tables of every page anew, and name the pages that changed."""
    changed = {
        path.name: new
        for path in sorted((ROOT / "docs").glob("*.md"))
        if (new := written(old := path.read_text(encoding="utf-8"))) != old
    }
    hg.write(changed, ROOT / "docs")
    print(*(f"wrote docs/{name}" for name in changed), sep="\n")


if __name__ == "__main__":
    main()
