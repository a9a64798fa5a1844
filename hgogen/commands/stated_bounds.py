"""How far errors go under the noise and the like that a model declares."""

from collections.abc import Callable
from dataclasses import replace

import hgogen as hg
from hgogen.call import CallableStep
from hgogen.certificates.error_bound import ErrorBound
from hgogen.model import MissingPart, Model
from hgogen.prove.questions import Signed
from hgogen.prove.semidefinite import NoSolver
from hgogen.reading.given import BadGain, BadNames


def bound_of(step: CallableStep, model: Model) -> ErrorBound | None:
    """How well each state is known under what the model says of noise and the like; None where it says nothing.

    Raises: `NoSolver`; `MissingPart` for what is no size, or of no signal.
    """
    if model.bounds is None:
        return None
    try:
        return hg.error_bound(step, **model.bounds.sizes)
    except (BadNames, BadGain) as error:
        raise MissingPart(model.path, f"in bounds, {error}") from None


def proved(step: CallableStep, model: Model, say: Callable[[str], None]) -> ErrorBound | None:
    """`bound_of`, None without a solver; `say` is called with what stands in the way."""
    try:
        known = bound_of(step, model)
    except NoSolver as missing:
        say(str(missing))
        return None
    if known and known.missing:
        say(f"{model.path}: {known.missing}")
    return known


def stating(step: CallableStep, model: Model, known: ErrorBound | None) -> CallableStep:
    """The step whose code states what is known of its errors, or that nothing is; as it is where the model does not
    ask."""
    if model.bounds is None:
        return step
    return replace(step, signed=known.signed if known else Signed())
