"""A library run: many models from one JSON file, each answered in a process of its own.

IN is {"models": [model, ..]} as `reading.entry` reads them; OUT is one object from name to answer, the fields of
`commands.answers`, null where there is no answer, and where they apply "error", a sentence, "partial": true where the
time limit struck, and "notes", sentences on questions that failed and on bounds of what has no value somewhere.
"""

import json
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from hgogen.commands.answers import FIELDS, answers
from hgogen.commands.workers import End, run
from hgogen.errors import HgogenError
from hgogen.reading.content import Unread, content_of
from hgogen.reading.entry import FORMAT, entry

BYTES = 1 << 28  # of a library
LIMIT = 10.0  # seconds of the processor for each model


@dataclass(eq=False)
class BadLibrary(HgogenError):
    """A library file that cannot be read."""

    path: str
    reason: str

    def __str__(self) -> str:
        return f'{self.path}: {self.reason}; a library is JSON, {{"models": [MODEL, ..]}}, a MODEL such as {FORMAT}'


def read(path: Path) -> list[tuple[str, Any]]:
    """The models of a file, each with the name that its answer has.

    Raises: `BadLibrary`.
    """
    try:
        content = json.loads(content_of(path, BYTES))
    except Unread as error:
        raise BadLibrary(str(path), error.reason) from None
    except (ValueError, RecursionError) as error:
        raise BadLibrary(str(path), f"is no JSON ({error})") from None
    models = content.get("models") if isinstance(content, Mapping) else None
    if not isinstance(models, list):
        raise BadLibrary(str(path), 'has no list "models"')
    return [(_name(model, k), model) for k, model in enumerate(models)]


def _name(model: Any, k: int) -> str:
    name = model.get("name") if isinstance(model, Mapping) else None
    return name if isinstance(name, str) else f"models[{k}]"


def check(
    models: list[tuple[str, Any]], *, limit: float = LIMIT, tick: Callable[[], None] = lambda: None
) -> dict[str, dict[str, Any]]:
    """The answers by name, in the models' order; `tick` is called after each.

    Args: `limit`: seconds of the processor for each model; what was found until then is kept.
    """
    names = [name for name, _ in models]
    answers: dict[str, dict[str, Any]] = {name: dict.fromkeys(FIELDS) for name in names}
    tasks = []
    for name, model in models:
        if names.count(name) > 1:
            answers[name]["error"] = f"{names.count(name)} models are named {name!r}; rename all but one"
            tick()
        elif isinstance(model, Mapping) and not isinstance(model.get("name"), str):
            answers[name]["error"] = "has no name; give it one, a text"
            tick()
        else:
            tasks.append((name, model))
    for event in run(_answered, [model for _, model in tasks], limit=limit):
        answer = answers[tasks[event.task][0]]
        if event.end is None:
            field, value = event.result
            if field == "note":
                answer.setdefault("notes", []).append(value)
            else:
                answer[field] = value
            continue
        if event.end is End.LATE:
            answer["partial"] = True
        if event.end is End.CRASHED:
            answer["error"] = "the process that worked on it ended; the answers are those found before"
        tick()
    return answers


def _answered(model: Any) -> Iterator[tuple[str, Any]]:
    """What a worker does with a model."""
    try:
        read_ = entry(model)
    except HgogenError as error:
        yield "error", str(error)
        return
    yield from answers(read_)
