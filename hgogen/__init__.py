"""hgogen turns a plant into a step, through four values, and hands the step to readers.

plant : System --form--> Form --observer--> Observer --method, dt--> Step --target--> files
                                                                       --call------> numbers
"""

from hgogen import design, forms, innovation, methods, observers, targets, theta, trial
from hgogen.call import Run, Sample, sample
from hgogen.casadi_model import from_casadi
from hgogen.check import Check, Verdict
from hgogen.dissipation import Dissipation, dissipation
from hgogen.error_system import ErrorSystem, error_system
from hgogen.errors import HgogenError
from hgogen.form import Form
from hgogen.gramian import gramian
from hgogen.observability import observability
from hgogen.observer import Observer
from hgogen.query import bound, nonzero
from hgogen.recast import recast
from hgogen.reference import reference
from hgogen.response import response
from hgogen.signal import Signal
from hgogen.singularity import singularity
from hgogen.step import Step
from hgogen.survey import survey
from hgogen.system import System
from hgogen.target import write

__all__ = [
    "Check",
    "Dissipation",
    "ErrorSystem",
    "Form",
    "HgogenError",
    "Observer",
    "Run",
    "Sample",
    "Signal",
    "Step",
    "System",
    "Verdict",
    "bound",
    "design",
    "dissipation",
    "error_system",
    "forms",
    "from_casadi",
    "gramian",
    "innovation",
    "methods",
    "nonzero",
    "observability",
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
