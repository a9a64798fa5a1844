"""The tables of the pages in docs/ that can be computed: `python tests/doc_tables.py` writes them anew.

A table stands between the lines `<!-- table: NAME -->` and `<!-- end -->`. The observers keep the order in which they
stand in the page. What trials of starting gains show takes minutes, and is computed anew by the option `--trials` only.
"""

import re
import sys
import warnings
from collections.abc import Callable, Iterable, Mapping
from functools import cache
from importlib import import_module

import numpy as np
from pages import DOCS, PAGES, ROOT
from scipy.linalg import expm

import hgogen as hg
from hgogen.call import CallableStep
from hgogen.emit.cost import cost
from hgogen.model import load
from hgogen.modelfiles.place import shipped
from hgogen.modelfiles.tuning import First, first, places
from hgogen.registry import summary
from hgogen.rigor.functions import ARGUMENTS, INSTEAD, WRITTEN
from hgogen.run.gates import GateShare, gate_shares
from hgogen.run.metrics import metrics
from hgogen.starting import rule
from hgogen.trial import Trial, try_out

TABLE = re.compile(r"^<!-- table: (\w+) -->\n(.*?)^<!-- end -->$", re.MULTILINE | re.DOTALL)

Words = Mapping[str, list[str]]  # the cells of each row as they stand, by its first cell


def written(text: str, trials: bool = False) -> str:
    """A page with its tables as they are now; those of trials as they stand, unless they are asked for."""

    def anew(match: re.Match[str]) -> str:
        name, rows = match.groups()
        rows = rows if name in TRIED and not trials else {**TABLES, **TRIED}[name](words(rows))
        return f"<!-- table: {name} -->\n{rows}<!-- end -->"

    return TABLE.sub(anew, text)


def words(table: str) -> Words:
    """The cells of each row of a table."""
    rows = [[cell.strip() for cell in line.strip("| ").split(" | ")] for line in table.splitlines()]
    return {row[0].strip("`"): row for row in rows}


def table(head: Iterable[str], rows: Iterable[Iterable[str]]) -> str:
    """A table in Markdown."""
    head = list(head)
    lines = [head, ["---"] * len(head), *map(list, rows)]
    return "".join(f"| {' | '.join(line)} |\n" if line[0] != "---" else f"|{'|'.join(line)}|\n" for line in lines)


@cache
def counted(name: str) -> str:
    """Operations and functions of a sample of the pendulum's tuning."""
    one = cost(load(ROOT / "models" / "pendulum.py").step(name))
    return f"{one.operations} + {one.functions}"


def _observers(old: Words) -> str:
    cases = hg.observers.__all__
    order = [*(name for name in old if name in cases), *(name for name in cases if name not in old)]
    said = {name: rule(getattr(hg.observers, name)) for name in cases}
    rows = ((f"`{name}`", said[name].where, said[name].asks, said[name].state, counted(name)) for name in order)
    return table(("observer", "use it if", "what it requires, and what is proved", "state", "cost"), rows)


def _cases(kind: str) -> Callable[[Words], str]:
    def made(old: Words) -> str:
        texts = {name: summary(kind, name) for name in getattr(hg, kind).__all__}
        return table((kind.removesuffix("s"), "what it is"), ((f"`{name}`", text) for name, text in texts.items()))

    return made


def _folders(old: Words) -> str:
    from house import COLUMN  # the order that a test holds them to

    lines = ((f"`{folder}/`", _line(folder)) for folder in COLUMN)
    return table(("folder", "what is in it"), lines)


def _functions(old: Words) -> str:
    counts: dict[str, list[str]] = {}
    for name, (_, least, most) in sorted(WRITTEN.items()):
        counts.setdefault(str(least) if least == most else f"{least} to {most}", []).append(f"`{name}`")
    rows = [(count, ", ".join(names)) for count, names in counts.items()]
    pairs = f"`Piecewise((value, condition), .., (value, True))`, of {ARGUMENTS} pairs at most"
    return table(("arguments", "functions"), [*rows, ("pairs", pairs)])


def _instead(old: Words) -> str:
    names: dict[str, list[str]] = {}
    for name, way in INSTEAD.items():
        names.setdefault(way, []).append(f"`{name}`")
    return table(("what to do", "in place of"), [(way, ", ".join(each)) for way, each in names.items()])


SEEDS, CALLS, DT = 200, 600, 0.1  # logs of a body on a spring, each of so many samples
Q, R = np.array([1e-3, 1e-2]), 1e-3


def _gates(old: Words) -> str:
    """What gates cost where Q and R are those of the plant, without outliers and with 5 % of a hundred sigma."""
    x, y = _measured_bodies(np.random.default_rng(0))
    wrong = np.random.default_rng(1).random(y.shape) < 0.05
    plain, _ = _estimated(x, y, None)
    missing, _ = _estimated(x, np.where(wrong, np.nan, y), None)
    rows = []
    for probability in (0.9, 0.99, 0.999, None):
        error, shares = _estimated(x, y, probability)
        with_outliers, _ = _estimated(x, y + 100 * np.sqrt(R / DT) * wrong, probability)
        share = 100 * np.mean([one.share for one in shares] or [0])
        name = f"`{probability}`" if probability else "no gate"
        rows.append((name, f"{share:.2f} %", f"{error / plain:.3f}", f"{with_outliers / missing:.3g}"))
    return table(("probability", "samples beyond", "error, without outliers", "error, with outliers"), rows)


def _measured_bodies(rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Place and velocity (B, N, 2) of bodies on a spring that noise moves from rest, and measured places (B, N, 1)."""
    motion, z, x = expm(DT * np.array([[0, 1], [-0.25, -0.1]])), np.zeros((SEEDS, 2)), []
    for _ in range(CALLS):
        x.append(z)
        z = z @ motion.T + np.sqrt(DT * Q) * rng.standard_normal(z.shape)
    places = np.array(x).swapaxes(0, 1)
    return places, places[:, :, :1] + np.sqrt(R / DT) * rng.standard_normal((SEEDS, CALLS, 1))


def _estimated(x: np.ndarray, y: np.ndarray, probability: float | None) -> tuple[float, list[GateShare]]:
    """RMS error of a Kalman filter, and the samples beyond its gate in each log."""
    place, rate = hg.Signal("place", low=-9, high=9), hg.Signal("rate", low=-9, high=9)
    flow = [rate, -place / 4 - rate / 10]
    body = hg.System("body", states=(place, rate), outputs=(hg.Signal("y"),), flow=flow, output=[place])
    gate = {"y": probability} if probability else None
    step = hg.sample(hg.observers.riccati(hg.forms.original(body), Q=Q, R=R, gate=gate), dt=DT)
    batch = step.run_many(y=y)
    return float(np.sqrt(np.mean((batch.x - x) ** 2))), [
        s for status in batch.status for s in gate_shares(step, status)
    ]


def _line(folder: str) -> str:
    """The first line of a folder's docstring."""
    text = (import_module(f"hgogen.{folder}").__doc__ or "").partition("\n")[0].rstrip(".")
    return text[:1].lower() + text[1:]


def _starting(old: Words) -> str:
    models = {name: load(path) for name, path in shipped().items()}
    rows = (_tried(name) for name, model in models.items() if model.has("trial") and name not in SLOW)
    return table(("model", "observers that settle", "settling time", "observers that do not"), rows)


def _tried(name: str) -> tuple[str, ...]:
    """The row of a model, shown as soon as it is there."""
    row = settled(name)
    print(*row, sep="  ", file=sys.stderr)
    return row


def settled(name: str) -> tuple[str, ...]:
    """Of the observers that a plant admits with starting gains, how many settle after every event of the model's first
    trial, its first seed, in which times after the first one, and which do not."""
    model = load(name)
    trial, survey = model.trials()[0], hg.survey(model.plant, deep=True)
    made = {kind: first(kind, places(survey)) for kind in hg.observers.__all__}
    steps = {kind: one.step for kind, one in made.items() if isinstance(one, First)}
    times = {kind: _settled(step, trial) for kind, step in steps.items()}
    known = sorted(time for time in times.values() if time is not None)
    span = f"{known[0]:.2g} to {known[-1]:.2g} {model.plant.time}" if known else "never"
    late = ", ".join(kind for kind, time in times.items() if time is None) or "none"
    return f"`{name}`", f"{len(known)} of {len(times)}", span, late


def _settled(step: CallableStep, trial: Trial) -> float | None:
    """The time to settle after the first event; None where it does not settle after some event."""
    with warnings.catch_warnings(action="ignore"):
        (trajectory,) = try_out(step, trial, seeds=trial.seeds[:1])
    times = [response.settled for response in metrics(step, trajectory).responses]
    return None if None in times else times[0]


SLOW = {"magnetic_levitation"}  # the observers on its phase form, with first gains, take many minutes
TRIED: Mapping[str, Callable[[Words], str]] = {"starting": _starting}
TABLES: Mapping[str, Callable[[Words], str]] = {
    "observers": _observers,
    "forms": _cases("forms"),
    "methods": _cases("methods"),
    "folders": _folders,
    "functions": _functions,
    "gates": _gates,
    "instead": _instead,
}


def main() -> None:
    """Write the tables of every page anew, and name the pages that changed."""
    changed = {
        path.relative_to(DOCS).as_posix(): new
        for path in PAGES.values()
        if (new := written(old := path.read_text(encoding="utf-8"), trials="--trials" in sys.argv)) != old
    }
    hg.write(changed, DOCS)
    print(*(f"wrote docs/{name}" for name in changed), sep="\n")


if __name__ == "__main__":
    main()
