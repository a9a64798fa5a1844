"""What a model file raises, in words: its errors are code of the model too."""

from hgogen.errors import HgogenError


def sentence(error: Exception) -> str:
    """What an error says, after its type where it is none of hgogen's."""
    return _text(error) if isinstance(error, HgogenError) else f"{type(error).__name__}: {_text(error)}"


def ends_python(error: BaseException) -> str:
    """What a model does that raises what is no `Exception`, and the fix."""
    kind, text = type(error).__name__, _text(error)
    said = f" ({text})" if text else ""
    return f"raises {kind}{said}, which ends Python; leave it out, or raise an error that says what is wrong"


def _text(error: BaseException) -> str:
    """The text of an error; empty where its own `__str__` fails, which is code of the model too."""
    try:
        return str(error)
    except BaseException:
        return ""
