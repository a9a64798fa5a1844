"""The mathematics of a step for people, NAME.md: equations as LaTeX, gains, claims, hypotheses and references.

It accompanies the code of any language. C has it with a manual.
"""

from hgogen.emit.document import document
from hgogen.emit.manual import document_name
from hgogen.emit.syntax import Real, demand_real
from hgogen.step import Step, demand_step
from hgogen.target import Files


def markdown(step: Step, *, real: Real = "float") -> Files:
    """Return the Markdown document of a step: equations, gains, claims and references, equal for both values of `real`.
    Raises: `NoStep`, `BadReal`."""
    demand_step(step, "markdown")
    demand_real(real)
    return Files(((document_name(step), "\n".join(document(step)).rstrip("\n") + "\n"),))
