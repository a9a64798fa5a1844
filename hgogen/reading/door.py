"""What a question takes: a plant, an expression, limits, switches; anything else is met with a sentence."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache, wraps
from inspect import signature
from sys import float_info
from typing import Any, TypeVar, cast

import numpy as np
import sympy as sp

from hgogen.errors import HgogenError
from hgogen.reading.filename import shown
from hgogen.system import System

Asked = TypeVar("Asked", bound=Callable[..., Any])
_ANSWERS = 64  # of each question are remembered


@dataclass(eq=False)
class Misfit(HgogenError):
    """A `value` where something else belongs; `wanted` says what to give in its place."""

    what: str
    value: Any
    wanted: str

    def __str__(self) -> str:
        return f"{self.what} was given {shown(self.value)}, of type {type(self.value).__name__}; give {self.wanted}"


def asks(kind: type | tuple[type, ...], wanted: str) -> Callable[[Asked], Asked]:
    """For a function whose first argument must be of a kind: for anything else it raises `Misfit`, which says what is
    `wanted`."""

    def guards(question: Asked) -> Asked:
        name = next(iter(signature(question).parameters))

        @wraps(question)
        def guarded(*args: Any, **options: Any) -> Any:
            first = args[0] if args else options.get(name)
            if not isinstance(first, kind):
                raise Misfit(question.__name__, first, wanted)
            return question(*args, **options)

        return cast(Asked, guarded)

    return guards


def demand_switch(what: str, value: object) -> None:
    """Raise `Misfit` for anything but True or False."""
    if not isinstance(value, bool | np.bool_):
        raise Misfit(what, value, "True or False")


def switches(question: Asked) -> Asked:
    """For a function with keywords that are switches, of type bool: for anything but True or False, which would count
    as one of them, it raises `Misfit`."""
    names = [each.name for each in signature(question).parameters.values() if each.annotation in (bool, "bool")]

    @wraps(question)
    def guarded(*args: Any, **options: Any) -> Any:
        for name in names:
            demand_switch(f"{question.__name__}, {name}=", options.get(name, False))
        return question(*args, **options)

    return cast(Asked, guarded) if names else question


asks_a_plant = asks(System, "a plant, an hg.System; of a model file it is hg.load(path).plant")


def remembers(question: Asked) -> Asked:
    """The function with its last answers, which do not change: a survey, the observers that are tried and each command
    ask the same of one plant, and of one form. What cannot be compared is asked anew."""

    @lru_cache(maxsize=_ANSWERS)
    def once(args: tuple[Any, ...], options: tuple[tuple[str, Any], ...]) -> Any:
        return question(*args, **dict(options))

    @wraps(question)
    def remembered(*args: Any, **options: Any) -> Any:
        pairs = tuple(options.items())
        try:
            hash((args, pairs))
        except TypeError:
            return question(*args, **options)
        return once(args, pairs)

    return cast(Asked, remembered)


def scalar(value: Any, what: str) -> sp.Expr:
    """The SymPy expression of a number or of an expression. Raises: `Misfit`."""
    try:
        expression = sp.sympify(value, strict=True)
    except (sp.SympifyError, TypeError):
        expression = None
    if not isinstance(expression, sp.Expr) or expression.is_Matrix:
        raise Misfit(what, value, "one expression, SymPy or text such as 'x1**2 - 1'")
    return expression


def limits(what: str, boxes: int, relative: float = 0.0) -> None:
    """Raise `Misfit` unless at least one box may be tried, and `relative` is a number from 0 on."""
    if isinstance(boxes, bool) or not isinstance(boxes, int) or boxes < 1:
        raise Misfit(f"{what}, boxes=", boxes, "a whole number from 1 on")
    if isinstance(relative, bool) or not isinstance(relative, int | float) or not 0 <= relative <= float_info.max:
        raise Misfit(f"{what}, relative=", relative, "a number from 0 on, such as 0.02")
