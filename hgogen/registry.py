"""The folder is the registry: every file of a plural folder is a case and has one public name, its own.

What is installed beside them: libraries that few need, else a sentence that says how to install them; the version.
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
from typing import Any

from hgogen.errors import HgogenError

PACKAGE = Path(__file__).resolve().parent


@dataclass(eq=False)
class NoCase(HgogenError):
    """A file in a registry folder that does not define its own name."""

    module: str
    name: str
    text = "{module} defines no {name!r}; give the case its file's name, or move the file elsewhere"


def load(package: str) -> dict[str, Any]:
    """Import every module of the package, in alphabetical order; return {case name: its public object}.

    Loading is eager because importing a module later would bind the package's attribute to the module in place of the
    case. That hides the file's docstring too: a function's own follows it, so that help() shows equations and reference
    before the arguments, and a value has it in the place of its class's.

    Raises: `NoCase`.
    """
    loaded = {}
    for name in sorted(info.name for info in iter_modules(sys.modules[package].__path__)):
        module = import_module(f"{package}.{name}")
        if name not in vars(module):
            raise NoCase(module.__name__, name)
        case = loaded[name] = vars(module)[name]
        if isfunction(case) and case.__doc__ and module.__doc__:
            file, own = cleandoc(module.__doc__), cleandoc(case.__doc__)
            case.__doc__ = own if own.startswith(file) else f"{file}\n\n{own}"  # once
        elif is_dataclass(case) and not isinstance(case, type):
            object.__setattr__(case, "__doc__", module.__doc__)  # help() shows a value's own, else all of its class
    return loaded


Names = tuple[list[str], Callable[[], list[str]], Callable[[str], Any]]


def cases_of(package: str, prepared: Callable[[Any], Any] = lambda case: case) -> Names:
    """Bind the cases of a folder, each as it is `prepared`, to the names of its package; return what its `__init__`
    calls `__all__`, `__dir__` and `__getattr__`, of which the last tells a type checker that there are such names.

    Raises: `NoCase`.
    """
    loaded = {name: prepared(case) for name, case in load(package).items()}
    names = list(loaded)
    vars(sys.modules[package]).update(loaded)

    def missing(name: str) -> Any:
        raise AttributeError(f"module {package!r} has no attribute {name!r}")

    return names, lambda: names, missing


def cases(folder: str) -> list[str]:
    """The names of the cases of a folder of the package, such as "forms", none of which is imported."""
    return sorted(info.name for info in iter_modules([str(PACKAGE / folder)]))


def summary(folder: str, name: str) -> str:
    """The summary of a case: the first line of its file's docstring; nothing of it is run."""
    tree = ast.parse((PACKAGE / folder / f"{name}.py").read_text(encoding="utf-8"))
    return (ast.get_docstring(tree) or "").partition("\n")[0].strip()


# ---------------------------------------------------------------- optional


@dataclass(eq=False)
class NotInstalled(HgogenError):
    """A library that is not installed, what it is needed for, and the extra of hgogen that brings it."""

    what: str
    library: str
    extra: str
    text = '{what} needs {library}; install it: pip install "hgogen[{extra}]"'


def library(name: str, what: str, extra: str = "logs") -> Any:
    """The module of that name. Raises: `NotInstalled`, of `what` needs it."""
    try:
        return import_module(name)
    except ImportError:
        raise NotInstalled(what, name.partition(".")[0], extra) from None


@cache
def version() -> str:
    """The version of pyproject.toml, as it was installed."""
    return metadata.version("hgogen")
