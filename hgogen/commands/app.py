"""The command line: from a model file to an observer in C and in Python.

Exit status 0: done; 1: a hypothesis refuted that nobody accepted, C and Python (or C and its recorded vectors)
disagree, a certificate is not verified, or a cost is above its limit; 2: wrong usage or bad input. Results go to the
standard output, as tables or, with --json, as JSON alone; everything else goes to the standard error stream.
"""

import ast
from functools import cache
from importlib import import_module
from pathlib import Path
from typing import Annotated, Any

import typer
from typer.core import TyperCommand, TyperGroup

_FILES = {
    "build": "building",
    "check": "checking",
    "compare": "comparing",
    "cost": "building",
    "report": "reporting",
    "design": "designing",
    "response": "designing",
    "recheck": "verifying",
    "generate": "building",
    "simulate": "building",
    "run": "running",
    "inspect": "running",
    "noise": "running",
    "advise": "calibrating",
    "fit": "fitting",
    "tune": "calibrating",
    "window": "running",
    "list": "listing",
    "new": "listing",
    "schema": "listing",
    "doctor": "doctor",
}  # the file of each command in this folder


def command_of(name: str) -> TyperCommand:
    """Return the command with this name, after importing its file."""
    imported: TyperCommand = getattr(import_module(f"hgogen.commands.{_FILES[name]}"), f"{name}_")
    return imported


class _Deferred(TyperCommand):
    """A placeholder for a command, whose file is imported only when the command runs or prints its own help."""

    def make_context(self, info_name: str | None, args: list[str], parent: Any = None, **extra: Any) -> Any:
        return command_of(str(self.name)).make_context(info_name, args, parent=parent, **extra)


def known() -> list[str]:
    """Return the names of all commands."""
    return list(_FILES)


class _Commands(TyperGroup):
    def __init__(self, **settings: Any) -> None:
        super().__init__(**settings)
        for name, file in _FILES.items():
            self.add_command(_Deferred(name, callback=None, help=_help(file, f"{name}_")))


@cache
def _help(file: str, name: str) -> str:
    """Return the docstring of a command's function by parsing
    its file, which is not imported: start-up stays fast."""
    tree = ast.parse(Path(__file__).with_name(f"{file}.py").read_text(encoding="utf-8"))
    definition = next(node for node in tree.body if isinstance(node, ast.FunctionDef) and node.name == name)
    return ast.get_docstring(definition) or ""


def _version(requested: bool) -> None:
    if requested:
        import hgogen

        typer.echo(f"hgogen {hgogen.__version__}")
        raise typer.Exit()


def _main(
    version: Annotated[
        bool, typer.Option("--version", is_eager=True, callback=_version, help="Print the version and exit.")
    ] = False,
) -> None:
    """Accept the options before a command."""


app = typer.Typer(
    cls=_Commands,
    callback=_main,
    help="From a nonlinear model to an observer: readable C for firmware and a running Python step.",
    epilog="Exit status: 0 done, 1 a refuted hypothesis nobody accepted, a failed comparison, a certificate that is "
    "not verified or a cost above its limit, 2 usage or bad input.",
    no_args_is_help=True,
    rich_markup_mode="markdown",
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)
