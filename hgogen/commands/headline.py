"""The answer of `check` in one line: what is observable, which form the plant is in, whether the observer converges."""

from collections.abc import Iterable

from hgogen.check import Check, Verdict
from hgogen.commands.jobs import Checked
from hgogen.observability import Observability

_PROVED, _REFUTED = Verdict.PROVED, Verdict.REFUTED


def headline(seen: Observability, claims: Checked) -> str:
    """As "pendulum: locally observable; triangular, proved; convergence unknown"."""
    return f"{claims.plant}: " + "; ".join((_observed(seen), _form(claims), _converges(claims)))


def _observed(seen: Observability) -> str:
    rank, known = seen.known.rank, seen.checks[0]
    if not rank.unobservable:
        return "locally observable"
    hidden = _few([s.name for s in rank.unobservable])
    return f"{hidden} not {'observable' if known.verdict is _REFUTED else 'seen'}"


def _form(claims: Checked) -> str:
    form = claims.form
    if not (claims.demanded or form.structured):
        return "in none of the forms asked"
    failed = [check for check in form.checks if check.verdict is _REFUTED]
    if failed:
        known = "accepted" if all(check.id in claims.accepted for check in failed) else "refuted"
        return f"{form.kind} but for {_names(failed)} ({known})"
    doubtful = [check for check in form.checks if check.verdict is not _PROVED]
    if doubtful:
        return f"{form.kind} as far as is known: {_names(doubtful)} not proved"
    return f"{form.kind}, proved"


def _converges(claims: Checked) -> str:
    if not claims.observer:
        return "its observer is refused" if claims.demanded else "no observer"
    known = {
        check.id.rpartition(".")[2]: check.verdict for check in claims.checks if check.id.startswith(claims.observer)
    }
    if known.get("convergence") is not _PROVED:
        return "convergence unknown"
    if "theta" not in known:
        return "convergence proved in continuous time"
    above = "for its theta" if known["theta"] is _PROVED else "for a larger theta only"
    return f"convergence proved in continuous time, {above}"


def _names(checks: Iterable[Check]) -> str:
    return _few([check.id.partition(".")[2] for check in checks])


def _few(names: list[str]) -> str:
    return ", ".join(names if len(names) <= 4 else [*names[:3], "..", names[-1]])
