"""The claims about a model, as commands show them: of its step's observer, or of a form alone."""

from collections.abc import Iterable
from dataclasses import asdict, dataclass, replace
from typing import Any

import hgogen as hg
from hgogen.call import CallableStep
from hgogen.certificates.admitted import Admitted, admitted
from hgogen.certificates.error_bound import ErrorBound
from hgogen.check import Check, Refuted, refuted
from hgogen.commands.stated_bounds import bound_of
from hgogen.form import Form
from hgogen.guarantees.bounded_theta import Nothing
from hgogen.guarantees.lmi import NoSolver
from hgogen.model import Model
from hgogen.program import Field
from hgogen.reading.named import by_name, written
from hgogen.sentence import Sentence, equations
from hgogen.signal import Signal
from hgogen.theorem import Row, Theorem, rows
from hgogen.which_forms import Survey


@dataclass(frozen=True)
class Checked:
    """The claims about a model: of its step's observer, or of a form where it has no step or the observer refused it.

    `observer`: its name, or ""; `theorem`: the observer's; `notes`: what is not claimed, and why; `demanded`:
    whether there is an observer, which needs what is refuted; `step`: the step that was built, of the tuning `tuning`,
    "" of the model's own; `known`: how far its errors go under what the model says of noise and the like, None where it
    says nothing; `dt`: up to which dt its step is certified, advised and admitted, where the first may be.
    """

    plant: str
    form: Form
    checks: tuple[Check, ...]
    accepted: tuple[str, ...]
    observer: str = ""
    theorem: Theorem | None = None
    notes: tuple[str, ...] = ()
    demanded: bool = True
    step: CallableStep | None = None
    tuning: str = ""
    known: ErrorBound | None = None
    dt: Admitted | None = None

    @property
    def gains(self) -> tuple[Field, ...]:
        """The observer's."""
        return self.step.gains if self.step else ()

    @property
    def shown(self) -> bool:
        """Whether the checks tell more than why the plant is not in the form."""
        return self.demanded or self.form.structured

    @property
    def head(self) -> tuple[Sentence, ...]:
        """The form's coordinates and equations, and the observer's gains, line by line."""
        title, *lines = self.form.head
        origin = self.form.system.origin
        if origin is not None:  # the states that the observer's plant has in the place of the declared ones
            pairs = zip(self.form.system.states, origin.forward, strict=True)
            change = equations({new: old for new, old in pairs if new.name != str(old)})
            lines = [Sentence.of("  with {change}", change=change), *lines]
        gains = (Sentence.of("  {gain}", gain=written(gain)) for gain in self.gains)
        limits = (Sentence.of("  {limits}", limits=dt.sentence) for dt in (self.dt,) if dt)
        return (title, *lines, *gains, *limits)

    @property
    def hypotheses(self) -> tuple[Row, ...]:
        """What the observer's theorem assumes, and what is known of it."""
        return rows(self.theorem, self.checks) if self.theorem else ()

    @property
    def open(self) -> tuple[Check, ...]:
        """The refuted checks that nobody accepted."""
        return refuted(self.checks, self.accepted)

    def as_dict(self) -> dict[str, Any]:
        """For JSON."""
        listed = [{**c.as_dict(), "accepted": c.id in self.accepted} for c in self.checks]
        z, y = self.form.states, self.form.system.outputs
        equations = {
            "coordinates": _texts(z, self.form.to_form),
            "flow": _texts(z, self.form.flow),
            "outputs": _texts(y, self.form.output),
        }
        theorem = self.theorem and {
            "conclusion": self.theorem.conclusion,
            "reference": self.theorem.reference,
            "hypotheses": [row.as_dict() for row in self.hypotheses],
        }
        refused = [c.id for c in self.open]
        said = {"checks": listed, "refuted": refused, "theorem": theorem, "notes": list(self.notes)}
        gains = {gain.name: by_name(gain) for gain in self.gains}
        own = {"gains": gains, "dt": self.dt and asdict(self.dt)}
        return {"plant": self.plant, "form": self.form.kind, **equations, **own, **said}


def _texts(signals: Iterable[Signal], expressions: Iterable[Any]) -> dict[str, str]:
    return {s.name: str(expression) for s, expression in zip(signals, expressions, strict=True)}


def checked(model: Model, asked: Survey | None = None, name: str | None = None) -> Checked:
    """The claims of a model's tuning `name`, by default of its step; of a model without an observer those of the best
    of the forms `asked`, by default of those that do not take seconds. With them what the model declares of inequality
    (38).

    Raises: `MissingPart`, `ModelFails`.
    """
    claims, declared = _checked(model, asked, name), model.dissipation
    if declared is None:
        return claims
    note = f"of the errors e of {declared.system.name}: {declared.conclusion}"
    return replace(claims, checks=(*claims.checks, *declared.checks), notes=(*claims.notes, note))


def _checked(model: Model, asked: Survey | None, name: str | None) -> Checked:
    if name is None and not model.has("step"):
        asked = asked or hg.survey(model.plant)
        form = getattr(hg.forms, model.setting.form)(model.plant) if model.setting.form else asked.best
        notes = (*model.notes, _alone(model, asked, form))
        return Checked(model.plant.name, form, form.checks, (), notes=notes, demanded=False)
    try:
        step = model.step(name)
    except Refuted as error:
        if error.form is None:
            raise
        note = f"the observer of {model.path} is refused on this form, so its own claims are not in the list"
        known = tuple(check.id for check in error.form.checks if check.id in error.accepted)
        return Checked(model.plant.name, error.form, error.form.checks, known, notes=(*model.notes, note))
    observer = step.observer
    plain = Checked(model.plant.name, observer.form, observer.checks, observer.accepted, observer.name)
    own = replace(plain, theorem=observer.theorem, notes=model.notes, step=step, tuning=name or "")
    try:
        return _as_it_runs(own, step, model)
    except NoSolver as missing:
        return replace(own, notes=(*own.notes, str(missing)))


def _as_it_runs(claims: Checked, step: CallableStep, model: Model) -> Checked:
    """The claims with what is proved of the step itself, of an observer of which it can be; of another why not, where
    the model asks how far it errs.

    Raises: `NoSolver`; `MissingPart` for bounds in the model's file that are none.
    """
    error, gains = bound_of(step, model), _gains(step.observer, model)
    if step.observer.error is None:
        own = (error.check, *gains) if error else ()
        return replace(claims, checks=(*claims.checks, *own), known=error)
    known, noise, start = hg.contraction(step), hg.noise_gain(step), hg.start_set(step)
    bounds = (bound.check for bound in (noise, start, error) if bound and not isinstance(bound, Nothing))
    own = (*known.checks, *bounds, *gains)
    return replace(claims, checks=(*claims.checks, *own), known=error, dt=admitted(step, known))


def _gains(observer: hg.Observer, model: Model) -> tuple[Check, ...]:
    """The L2 gain and the bounds in continuous time under the noise and the disturbances that the model says, where it
    asks for them. Raises: `NoSolver`."""
    if model.bounds is None or not model.bounds.gains:
        return ()
    sizes = {what: each for what, each in model.bounds.sizes.items() if what in ("noise", "disturbance")}
    return hg.l2_gain(observer, **sizes).check, hg.iss_gain(observer, **sizes).check


def _alone(model: Model, asked: Survey, form: Form) -> str:
    """What a model without an observer does not claim."""
    proved = ", ".join(row.kind for row in asked.proved)
    if form.structured or model.setting.form:
        return f"{model.path} has no observer: the checks are those of the {form.kind} form alone"
    if proved:
        return f"{model.path} has no observer; of the forms asked its plant is in {proved}, proved, and in no other"
    return f"{model.path} has no observer, and its plant has the structure of none of the forms asked"
