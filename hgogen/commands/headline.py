"""The answer of `check` in one line: what is observable, which forms the plant is in, whether the observer converges.

The forms are the rows of the survey, which the table under it prints; the observer's own form is named where it is
none of those that are proved.
"""

from collections.abc import Iterable, Iterator

from hgogen.analysis.observability import Observability
from hgogen.analysis.undefined import MAKER
from hgogen.check import Check, ClaimId, Verdict
from hgogen.commands.checked import Checked
from hgogen.form import Form
from hgogen.theorem import convergence
from hgogen.trials.sight import Sight, as_share
from hgogen.which_forms import Survey

_PROVED, _REFUTED = Verdict.PROVED, Verdict.REFUTED


def headline(seen: Observability, survey: Survey, claims: Checked, least: Sight | None = None) -> str:
    """As "pendulum: locally observable; triangular, uniform, state_affine, proved; convergence unknown"."""
    said = (_observed(seen, least), *_forms(survey, claims), _converges(claims), *_runs(claims))
    return f"{claims.plant}: " + "; ".join(said)


def _observed(seen: Observability, least: Sight | None) -> str:
    known = seen.known
    if known.rank.unobservable:
        hidden, doubtful = (_few([s.name for s in names]) for names in (known.hidden, known.doubtful))
        said = [f"{hidden} not observable"] if hidden else []
        said += [f"whether {doubtful} can be observed is unknown"] if doubtful else []
        return ", ".join(said) + (f", where {known.condition}" if known.where else "")
    if known.elsewhere:
        first, *more = known.exceptions
        return f"locally observable, but {first}" + (", ..." if more else "")
    if least is not None and least.by_motion:
        return f"locally observable, {next(iter(least.direction))} by its motion alone"
    if least is not None and least.hopeless:
        return f"locally observable, but {next(iter(least.direction))} hopelessly little ({as_share(least.median, 1)})"
    return "locally observable"


def _forms(survey: Survey, claims: Checked) -> Iterator[str]:
    """Those in which the plant is proved to be, else the one that comes nearest; then the observer's, if that is
    another one."""
    proved = [row.kind for row in survey.proved]
    recast = claims.form.system.origin is not survey.plant.origin
    known = claims.demanded and not recast and claims.form.kind in (proved or [row.kind for row in survey.candidates])
    if proved:
        yield f"{', '.join(proved)}, proved"
    elif known:
        yield _form(claims.form, claims.accepted)
    else:
        yield _form(survey.best, ()) if survey.candidates else "in none of the forms asked"
    if claims.demanded and not known:
        yield f"its observer's form{', of the recast plant' * recast}: {_form(claims.form, claims.accepted)}"


def _form(form: Form, accepted: Iterable[str]) -> str:
    """A form with what is not proved of it."""
    failed = [check for check in form.checks if check.verdict is _REFUTED]
    if failed:
        known = "accepted" if all(check.id in accepted for check in failed) else "refuted"
        return f"{form.kind} but for {_names(failed)} ({known})"
    doubtful = [check for check in form.checks if check.verdict is not _PROVED]
    if doubtful:
        return f"{form.kind} as far as is known: {_names(doubtful)} not proved"
    return f"{form.kind}, proved"


def _converges(claims: Checked) -> str:
    if claims.observer:
        return str(convergence(claims.observer, claims.checks))
    return "its observer is refused" if claims.demanded else "no observer"


def _runs(claims: Checked) -> Iterator[str]:
    """Whether the step itself is proved, of an observer of which that is asked."""
    for check in claims.checks:
        if check.id == ClaimId(claims.observer, "step"):
            yield f"{'' if check.verdict is _PROVED else 'not '}proved as it runs"


def _names(checks: Iterable[Check]) -> str:
    return _few([str(check.id if check.id.maker == MAKER else check.id.short) for check in checks])


def _few(names: list[str]) -> str:
    return ", ".join(names if len(names) <= 4 else [*names[:3], "..", names[-1]])
