"""The base of every error of the checker, which shares no code with those that write certificates."""


class RecheckError(Exception):
    """Base class: a sentence that names the thing and the fix."""
