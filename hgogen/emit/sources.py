"""The files that a language makes of a step."""

from collections.abc import Iterable, Mapping

from hgogen.emit.fold import folded
from hgogen.emit.naming import renamed, says
from hgogen.emit.syntax import Syntax
from hgogen.step import Step
from hgogen.target import Recipe, Sources


def sources(step: Step, syntax: Syntax, files: Mapping[str, Iterable[str]], recipe: Recipe = ()) -> Sources:
    """Files of these lines, of which none is long, and the signals that the language calls otherwise."""
    texts = tuple((name, "\n".join(folded(lines)) + "\n") for name, lines in files.items())
    return Sources(texts, recipe, tuple(renamed(step, syntax).items()), tuple(filter(None, [says(step, syntax)])))
