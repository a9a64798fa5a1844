"""hgogen turns a plant into a step, through four values, and hands the step to readers.

plant : System --form--> Form --observer--> Observer --method, dt--> Step --target--> files
                                                                       --call------> numbers

What is public is imported when it is first asked for, so that `import hgogen` takes no time. A file that holds a
function of its own name (`response.py`: `response`) gives its function, whoever imports the file first: where Python
binds the file to the package, the function is bound in its place.
"""

import sys
from importlib import import_module
from types import ModuleType

TYPE_CHECKING = False
if TYPE_CHECKING:  # the same as in _FILES, for what reads types; a test compares the two
    from hgogen import design, forms, innovation, methods, observers, targets, theta, trial
    from hgogen.call import sample
    from hgogen.casadi_model import from_casadi
    from hgogen.certificate import certificate
    from hgogen.check import Check, Verdict
    from hgogen.dissipation import Dissipation, dissipation
    from hgogen.error_system import ErrorSystem, error_system
    from hgogen.errors import HgogenError
    from hgogen.form import Form
    from hgogen.gramian import gramian
    from hgogen.model import Model, load
    from hgogen.observability import observability
    from hgogen.observer import Observer
    from hgogen.observer_errors import observer_errors
    from hgogen.query import bound, nonzero
    from hgogen.recast import recast
    from hgogen.reference import reference
    from hgogen.response import response
    from hgogen.samples import Run, Sample
    from hgogen.signal import Signal
    from hgogen.singularity import singularity
    from hgogen.step import Step
    from hgogen.survey import survey
    from hgogen.system import System
    from hgogen.target import write

_FILES = {  # a public name, and the file that holds it, "" for a file or folder itself
    **dict.fromkeys(("design", "forms", "innovation", "methods", "observers", "targets", "theta", "trial"), ""),
    **dict.fromkeys(("Run", "Sample"), "samples"),
    "sample": "call",
    "from_casadi": "casadi_model",
    "certificate": "certificate",
    **dict.fromkeys(("Check", "Verdict"), "check"),
    **dict.fromkeys(("Dissipation", "dissipation"), "dissipation"),
    **dict.fromkeys(("ErrorSystem", "error_system"), "error_system"),
    "HgogenError": "errors",
    "Form": "form",
    "gramian": "gramian",
    **dict.fromkeys(("Model", "load"), "model"),
    "observability": "observability",
    "Observer": "observer",
    "observer_errors": "observer_errors",
    **dict.fromkeys(("bound", "nonzero"), "query"),
    "recast": "recast",
    "reference": "reference",
    "response": "response",
    "Signal": "signal",
    "singularity": "singularity",
    "Step": "step",
    "survey": "survey",
    "System": "system",
    "write": "target",
}

__all__ = [
    "Check",
    "Dissipation",
    "ErrorSystem",
    "Form",
    "HgogenError",
    "Model",
    "Observer",
    "Run",
    "Sample",
    "Signal",
    "Step",
    "System",
    "Verdict",
    "bound",
    "certificate",
    "design",
    "dissipation",
    "error_system",
    "forms",
    "from_casadi",
    "gramian",
    "innovation",
    "load",
    "methods",
    "nonzero",
    "observability",
    "observer_errors",
    "observers",
    "recast",
    "reference",
    "response",
    "sample",
    "singularity",
    "survey",
    "targets",
    "theta",
    "trial",
    "write",
]


class _Package(ModuleType):
    """This package, with what it does when a name is asked for and when a file is bound to it."""

    def __getattr__(self, name: str) -> object:
        if name not in _FILES:
            raise AttributeError(f"module {__name__!r} has no attribute {name!r}", name=name, obj=self)
        found: object = import_module(f"{__name__}.{_FILES[name] or name}")
        found = getattr(found, name) if _FILES[name] else found
        setattr(self, name, found)
        return found

    def __setattr__(self, name: str, value: object) -> None:
        own = isinstance(value, ModuleType) and _FILES.get(name) == name
        super().__setattr__(name, getattr(value, name) if own else value)

    def __dir__(self) -> list[str]:
        return sorted({*super().__dir__(), *__all__})


sys.modules[__name__].__class__ = _Package
