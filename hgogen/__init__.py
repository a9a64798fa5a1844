"""hgogen turns a plant into a step, through four values, and hands the step to readers.

plant : System --form--> Form --observer--> Observer --method, dt--> Step --target--> files
                                                                       --call------> numbers

What is public is imported when it is first asked for, so that `import hgogen` takes no time.
"""

from importlib import import_module

TYPE_CHECKING = False
if TYPE_CHECKING:  # the same as in the tables below, for what reads types; a test compares them
    from hgogen import forms, methods, observers, targets, trial
    from hgogen.analysis.observability import observability
    from hgogen.analysis.query import bound, nonzero
    from hgogen.analysis.singularity import singularity
    from hgogen.calibration.advise import advise
    from hgogen.calibration.grid import Calibration
    from hgogen.calibration.tune import tune
    from hgogen.call import sample
    from hgogen.calling.samples import Run, Sample
    from hgogen.certificates.certificate import certificate
    from hgogen.certificates.contraction import Contraction, contraction
    from hgogen.certificates.error_bound import ErrorBound, error_bound, signed
    from hgogen.certificates.input_gains import IssGain, L2Gain, iss_gain, l2_gain
    from hgogen.certificates.noise_gain import NoiseGain, noise_gain
    from hgogen.certificates.start_set import StartSet, start_set
    from hgogen.check import Check, Verdict
    from hgogen.errors import HgogenError
    from hgogen.form import Form
    from hgogen.guarantees import design
    from hgogen.guarantees.dissipation import Dissipation, dissipation
    from hgogen.guarantees.error_system import ErrorSystem, error_system, observer_errors
    from hgogen.identification.fit import fit
    from hgogen.identification.records import Log, record
    from hgogen.identification.result import Fit
    from hgogen.kalman import innovation, theta
    from hgogen.model import Model, load
    from hgogen.observer import Observer
    from hgogen.reading.casadi_model import from_casadi
    from hgogen.reading.disturbed import with_disturbance
    from hgogen.reading.table import table
    from hgogen.signal import Signal
    from hgogen.starting import Starting, starting_gains
    from hgogen.step import Step
    from hgogen.stepping.delays import delayed
    from hgogen.structure.recast import recast
    from hgogen.system import System
    from hgogen.target import write
    from hgogen.trials import excitation
    from hgogen.trials.campaign import campaign
    from hgogen.trials.consistency import consistency
    from hgogen.trials.gramian import gramian
    from hgogen.trials.proposed import proposed_trial
    from hgogen.trials.reference import reference
    from hgogen.trials.response import response
    from hgogen.which_forms import survey

    __version__: str

_MODULES = {  # public files and folders
    **{name: name for name in ("forms", "methods", "observers", "targets", "trial")},
    "design": "guarantees.design",
    "excitation": "trials.excitation",
    "innovation": "kalman.innovation",
    "theta": "kalman.theta",
}
_NAMES = {  # what else is public, and the file that holds it
    **dict.fromkeys(("Run", "Sample"), "calling.samples"),
    "advise": "calibration.advise",
    "Calibration": "calibration.grid",
    "tune": "calibration.tune",
    "campaign": "trials.campaign",
    "sample": "call",
    "delayed": "stepping.delays",
    "from_casadi": "reading.casadi_model",
    "certificate": "certificates.certificate",
    **dict.fromkeys(("Contraction", "contraction"), "certificates.contraction"),
    **dict.fromkeys(("ErrorBound", "error_bound", "signed"), "certificates.error_bound"),
    **dict.fromkeys(("IssGain", "L2Gain", "iss_gain", "l2_gain"), "certificates.input_gains"),
    **dict.fromkeys(("NoiseGain", "noise_gain"), "certificates.noise_gain"),
    **dict.fromkeys(("StartSet", "start_set"), "certificates.start_set"),
    **dict.fromkeys(("Check", "Verdict"), "check"),
    **dict.fromkeys(("Dissipation", "dissipation"), "guarantees.dissipation"),
    **dict.fromkeys(("ErrorSystem", "error_system", "observer_errors"), "guarantees.error_system"),
    "HgogenError": "errors",
    "Form": "form",
    "Fit": "identification.result",
    "fit": "identification.fit",
    "Log": "identification.records",
    "record": "identification.records",
    "consistency": "trials.consistency",
    "gramian": "trials.gramian",
    **dict.fromkeys(("Model", "load"), "model"),
    "observability": "analysis.observability",
    "Observer": "observer",
    **dict.fromkeys(("bound", "nonzero"), "analysis.query"),
    "proposed_trial": "trials.proposed",
    "recast": "structure.recast",
    "reference": "trials.reference",
    "response": "trials.response",
    "Signal": "signal",
    "singularity": "analysis.singularity",
    **dict.fromkeys(("Starting", "starting_gains"), "starting"),
    "Step": "step",
    "survey": "which_forms",
    "System": "system",
    "table": "reading.table",
    "with_disturbance": "reading.disturbed",
    "write": "target",
}

__all__ = [
    "Calibration",
    "Check",
    "Contraction",
    "Dissipation",
    "ErrorBound",
    "ErrorSystem",
    "Fit",
    "Form",
    "HgogenError",
    "IssGain",
    "L2Gain",
    "Log",
    "Model",
    "NoiseGain",
    "Observer",
    "Run",
    "Sample",
    "Signal",
    "StartSet",
    "Starting",
    "Step",
    "System",
    "Verdict",
    "advise",
    "bound",
    "campaign",
    "certificate",
    "consistency",
    "contraction",
    "delayed",
    "design",
    "dissipation",
    "error_bound",
    "error_system",
    "excitation",
    "fit",
    "forms",
    "from_casadi",
    "gramian",
    "innovation",
    "iss_gain",
    "l2_gain",
    "load",
    "methods",
    "noise_gain",
    "nonzero",
    "observability",
    "observer_errors",
    "observers",
    "proposed_trial",
    "recast",
    "record",
    "reference",
    "response",
    "sample",
    "signed",
    "singularity",
    "start_set",
    "starting_gains",
    "survey",
    "table",
    "targets",
    "theta",
    "trial",
    "tune",
    "with_disturbance",
    "write",
]


def __getattr__(name: str) -> object:
    if name in _MODULES:
        value: object = import_module(f"{__name__}.{_MODULES[name]}")
    elif name in _NAMES:
        value = getattr(import_module(f"{__name__}.{_NAMES[name]}"), name)
    elif name == "__version__":
        value = import_module(f"{__name__}.reading.optional").version()
    else:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}", name=name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__, "__version__"})
