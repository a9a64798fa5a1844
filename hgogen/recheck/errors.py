"""The base of every error of the checker, which shares no code with those that write certificates."""

from typing import ClassVar


class RecheckError(Exception):
    """Base class: a sentence that names the thing and the fix; `status`: with which a command ends, 2 for what is no
    certificate, 1 for one that is not verified."""

    status: ClassVar[int] = 2
