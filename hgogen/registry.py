"""The registry of cases: every file of a plural folder is a case and has one public name, its own.

Optional libraries are imported here too, with a sentence that says how to install them, and the version is read.
"""

import ast
import sys
from collections.abc import Callable
from dataclasses import dataclass, is_dataclass
from functools import cache
from importlib import import_module, metadata
from inspect import cleandoc, isfunction
from pathlib import Path
from pkgutil import iter_modules
from types import ModuleType
from typing import Any

from hgogen.errors import HgogenError

PACKAGE = Path(__file__).resolve().parent


@dataclass(eq=False)
class NoCase(HgogenError):
    """The error for a file in a registry folder that does not define a case, an object with the file's name."""

    module: str
    name: str
    text = "{module} defines no {name!r}; give the case its file's name, or move the file elsewhere"


def case_in(module: ModuleType) -> Any:
    """Return the case in a file of a registry folder: the object that has the file's name.

    The docstring of its file comes first in the docstring of a function, so that help() shows equations and reference
    before the arguments, and replaces that of the class of a value.

    Raises: `NoCase`.
    """
    name = module.__name__.rpartition(".")[2]
    if name not in vars(module):
        raise NoCase(module.__name__, name)
    case = vars(module)[name]
    if isfunction(case) and case.__doc__ and module.__doc__:
        file, docstring = cleandoc(module.__doc__), cleandoc(case.__doc__)
        case.__doc__ = docstring if docstring.startswith(file) else f"{file}\n\n{docstring}"  # once
    elif is_dataclass(case) and not isinstance(case, type):
        object.__setattr__(case, "__doc__", module.__doc__)  # help() shows it in place of the class
    return case


Names = tuple[list[str], Callable[[], list[str]], Callable[[str], Any]]


def cases_of(package: str, prepared: Callable[[Any], Any] = lambda case: case) -> Names:
    """Return `__all__`, `__dir__` and `__getattr__` for the folder `package`, whose public names are its cases;
    `prepared`: a function that is applied to each case. The file of a case is imported when its name is first read, and
    the name is then bound to the case, not to the module. Raises: `NoCase`, when a case is read."""
    folder = sys.modules[package]
    names = sorted(info.name for info in iter_modules(folder.__path__))

    class Folder(ModuleType):
        def __setattr__(self, name: str, value: Any) -> None:
            is_case = isinstance(value, ModuleType) and name in names
            super().__setattr__(name, prepared(case_in(value)) if is_case else value)

    def case_called(name: str) -> Any:
        if name not in names:
            raise AttributeError(f"module {package!r} has no attribute {name!r}")
        import_module(f"{package}.{name}")
        return vars(folder)[name]

    folder.__class__ = Folder
    return names, lambda: names, case_called


def cases(folder: str) -> list[str]:
    """Return the names of the cases of a folder of the package, such as "forms", without importing them."""
    return sorted(info.name for info in iter_modules([str(PACKAGE / folder)]))


def summary(folder: str, name: str) -> str:
    """Return the summary of a case, the first line of its file's docstring, without running the file."""
    tree = ast.parse((PACKAGE / folder / f"{name}.py").read_text(encoding="utf-8"))
    return (ast.get_docstring(tree) or "").partition("\n")[0].strip()


# ---------------------------------------------------------------- optional


@dataclass(eq=False)
class NotInstalled(HgogenError):
    """The error for a library that is not installed, with its purpose and the extra of hgogen that contains it."""

    what: str
    library: str
    extra: str
    text = '{what} needs {library}; install it: pip install "hgogen[{extra}]"'


def library(name: str, what: str, extra: str = "logs") -> Any:
    """Return the imported module `name`; `what`: the purpose, `extra`: its extra. Raises: `NotInstalled`."""
    try:
        return import_module(name)
    except ImportError:
        raise NotInstalled(what, name.partition(".")[0], extra) from None


@cache
def version() -> str:
    """Return the version of pyproject.toml, as it was installed."""
    return metadata.version("hgogen")


class Displayed:
    """The base class of values that notebooks display as Markdown with equations in LaTeX."""

    def _repr_markdown_(self) -> str:
        return str(display("markdown_of")(self))


def display(name: str) -> Callable[..., Any]:
    """Return the function `name` of `hgogen.extras.display`, imported at its first use, since that module imports the
    classes that it displays."""
    function: Callable[..., Any] = getattr(import_module("hgogen.extras.display"), name)
    return function
