"""The places of model files: a path, the folder `models` here, and the package; the template of a new one, and the
errors of one that fails.

The shipped files lie in the folder `models` of an installed package. A clone has that folder next to the package.
"""

import ast
import os
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from hgogen.errors import HgogenError, nearest
from hgogen.reading.files import BYTES, READERS, Unread, content_of, declares
from hgogen.reading.files import demand_file_name as demand_name
from hgogen.target import CannotWrite

FOLDER = Path("models")
PYTHON = ".py"
SUFFIXES = (PYTHON, *READERS)
PACKAGE = Path(__file__).resolve().parents[1]
_NO_MODELS = f"give the path of a model file, or a bare name of one in ./{FOLDER} or of one that `hgogen list` shows"


@dataclass(eq=False)
class NoModel(HgogenError):
    """The error for a path without a model file; `guess`: a question that suggests another file."""

    path: str
    reason: str
    models: tuple[str, ...]
    guess: str = ""

    def __str__(self) -> str:
        there = f"the models here are {', '.join(self.models)}" if self.models else _NO_MODELS
        return f"{self.path}: {self.reason}; {self.guess or there}"


def listed(folder: Path = FOLDER) -> tuple[str, ...]:
    """Return the paths of the model files in a folder, by default ./models, sorted."""
    return tuple(sorted(map(str, _models(folder))))


def shipped(package: Path = PACKAGE) -> dict[str, Path]:
    """Return the paths of the model files that come with hgogen, by name: in the package, else in the folder `models`
    of a clone."""
    inside, in_clone = package / FOLDER, package.parent / FOLDER
    return {path.stem: path for path in sorted(_models(inside if inside.is_dir() else in_clone))}


def available() -> dict[str, str]:
    """Return the path of each model file by the name that `load` accepts. A file in ./models has its path as its name,
    a shipped file its bare name, unless a file in ./models has that name."""
    here = listed()
    names = {Path(path).stem for path in here}
    return {path: path for path in here} | {name: str(path) for name, path in shipped().items() if name not in names}


def located(model: str) -> Path:
    """Return the path of a model file, given as a path or as a bare name. Raises: `NoModel`."""
    path = Path(model)
    try:
        there = path.exists() and not path.is_dir()
    except OSError as error:  # a name that is too long
        raise NoModel(f"{str(model)[:60]}..", f"is no path of a file here ({error.strerror})", listed()) from None
    if there:
        if path.suffix not in SUFFIXES:
            raise NoModel(model, f"is no model file ({', '.join(SUFFIXES)})", listed())
        return path
    if named := _here(model):
        if len(named) > 1:
            several = f"the name is that of {len(named)} files; give the path of one"
            raise NoModel(model, several, tuple(map(str, named)))
        return named[0]
    if path.is_dir():
        inside = listed(path)
        guess = f"did you mean {path.name}?" if not inside and (_here(path.name) or path.name in shipped()) else ""
        raise NoModel(model, "is a folder, not a model file", inside or listed(), guess)
    if model in (ours := shipped()):
        return ours[model]
    guess = nearest(model, (*ours, *map(str, _models(path.parent))), "")
    raise NoModel(model, "there is no such model file", listed(), guess)


def _here(name: str) -> list[Path]:
    files = (FOLDER / f"{name}{suffix}" for suffix in SUFFIXES)
    return [file for file in files if name.isidentifier() and file.is_file()]


def _models(folder: Path) -> Iterator[Path]:
    files = (path for path in folder.glob("*") if path.suffix in SUFFIXES and path.is_file())
    return (path for path in files if not path.name.startswith("_") and (path.suffix == PYTHON or declares(path)))


def summary(path: str) -> str:
    """Return the first sentence of a model file's docstring or `meaning`; "" if there is none or the file cannot be
    read. The file is not executed."""
    suffix = Path(path).suffix
    try:
        text = content_of(path, BYTES)
        if suffix == PYTHON:
            meaning = ast.get_docstring(ast.parse(text)) or ""
        else:
            table = READERS[suffix](text.decode("utf-8-sig"))
            meaning = str(table.get("meaning", "")) if isinstance(table, dict) else ""
    except (Unread, ValueError, SyntaxError, RecursionError, MemoryError):  # `load` reports the error
        return ""
    return " ".join(meaning.partition("\n\n")[0].split()).partition(". ")[0].removesuffix(".")


_TEXT = Path(__file__).with_name("template.txt")
_NAME = "NAME"  # the placeholder of the model's name


def new_model(name: str, folder: Path) -> dict[str, str]:
    """Return the text of a new model file called `name`, by its file name. Raises: `BadName`, `BadFileName`,
    `HidesHeader` for a name that a plant or a file cannot have; `CannotWrite` if the folder holds such a file."""
    from hgogen.emit.naming import demand_file  # slow to import
    from hgogen.signal import check_name

    check_name(name)
    demand_file(name)
    file = f"{demand_name(name)}{PYTHON}"
    if os.path.lexists(folder / file):
        raise CannotWrite(str(folder / file), "it is there already", "take another name, or another folder by --out")
    return {file: _TEXT.read_text(encoding="utf-8").replace(_NAME, name)}


def sentence(error: Exception) -> str:
    """Return the text of an error, after its type unless it is an error of hgogen."""
    return _text(error) if isinstance(error, HgogenError) else f"{type(error).__name__}: {_text(error)}"


def ends_python(error: BaseException) -> str:
    """Return a sentence, with the remedy, on an error in a model that is no `Exception` and would end Python, such as
    SystemExit."""
    kind, text = type(error).__name__, _text(error)
    detail = f" ({text})" if text else ""
    return f"raises {kind}{detail}, which ends Python; leave it out, or raise an error that says what is wrong"


def _text(error: BaseException) -> str:
    """Return the text of an error; "" if `str(error)` fails, which may run code of a model."""
    try:
        return str(error)
    except BaseException:
        return ""
