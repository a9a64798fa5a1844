"""The README and the pages of docs/ as the tests read them: their text, and their blocks of code by language."""

import re
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
README = ROOT / "README.md"
DOCS = ROOT / "docs"
PAGES = {
    path.relative_to(DOCS).with_suffix("").as_posix(): path
    for path in sorted([*DOCS.glob("*.md"), *DOCS.glob("howto/*.md")])
}


def text(page: str) -> str:
    """The text of a page, by its path below docs/."""
    return PAGES[page].read_text(encoding="utf-8")


def everywhere() -> dict[str, str]:
    """The text of the README and of each page, by its path."""
    return {str(path.relative_to(ROOT)): path.read_text(encoding="utf-8") for path in (README, *PAGES.values())}


def blocks(language: str, of: str) -> list[str]:
    """The blocks of code of this language in a text."""
    return re.findall(rf"^```{re.escape(language)}\n(.*?)^```", of, re.MULTILINE | re.DOTALL)


def shown(command: str, *of: str) -> list[tuple[str, str]]:
    """Each line `$ COMMAND ..` of the consoles in these texts, by default all, and what is printed below it."""
    consoles = (block for one in of or everywhere().values() for block in blocks("console", one))
    return [
        (line, printed)
        for block in consoles
        for line, printed in re.findall(r"^\$ (.*)\n((?:[^$\n].*\n)*)", block, re.MULTILINE)
        if line.startswith(command)
    ]
