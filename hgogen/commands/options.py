"""What a user may say on the command line: the options that commands share, and how their texts are read."""

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal, TypedDict, TypeVar

import typer

from hgogen.commands.process import note
from hgogen.modelfiles.setting import SEEDS, Setting
from hgogen.run import native

if TYPE_CHECKING:  # what takes a second to import, and `hgogen list` and `recheck` do not need
    from hgogen.run.samples import Engine
    from hgogen.trial import Trial

Value = TypeVar("Value")
Reader = Literal["c", "python"]
ModelArgument = Annotated[
    str, typer.Argument(metavar="MODEL", help="A model file, or the name of one that `hgogen list` shows.")
]
Tuned = Annotated[
    str | None,
    typer.Option("--observer", metavar="NAME", help="A tuning of the model, or an observer."),
]
Seeds = Annotated[int | None, typer.Option(min=1, max=SEEDS, help="Number of noise seeds; by default the trial's.")]
Out = Annotated[Path | None, typer.Option("--out", "-o", help="Folder of the results; by default build/MODEL.")]
ReaderOption = Annotated[Reader | None, typer.Option("--engine", help="c or python; C where there is a compiler.")]
OneTrial = Annotated[str | None, typer.Option("--trial", help="The trial of this name; by default all.")]
Jobs = Annotated[
    int | None, typer.Option("--jobs", metavar="N", min=1, help="Processes, by default one for each core.")
]
Json = Annotated[bool, typer.Option("--json", help="Print JSON alone; the keys are listed above.")]
Data = Annotated[list[Path], typer.Option("--data", help="A log, a CSV, Parquet or MAT file; repeat it.")]
Truth = Annotated[
    list[str] | None,
    typer.Option("--truth", metavar="STATE=COLUMN", help="A hidden state that was measured; it judges alone."),
]
Shift = Annotated[
    list[str] | None,
    typer.Option(
        metavar="SIGNAL=SAMPLES",
        help="A signal taken so many samples later than it was logged, or earlier where negative; repeat it.",
    ),
]
Deep = Annotated[bool, typer.Option("--deep", help="Ask the forms too that may take seconds.")]
HeldOut = Annotated[
    float, typer.Option(min=0.0, max=0.9, help="The part at the end of each record that judges, and is not fitted.")
]


@dataclass(frozen=True)
class Runs:
    """A campaign as a user asks for it; None where nothing is said."""

    vary: Annotated[
        str | None,
        typer.Option(
            metavar="LIST",
            help="What differs from run to run, in its range, by 10%, by 0.2 or in 0.8..1.2: states by name or x0, "
            "parameters by name or `parameters`, noise, as in x0,a=10%,noise=0.5..2.",
        ),
    ] = None
    runs: Annotated[
        int | None, typer.Option(metavar="N", help="How many runs, 1000 by default; run k has noise seed k.")
    ] = None
    draw: Annotated[int | None, typer.Option(metavar="SEED", help="Seed of what varies, by default 0.")] = None
    jobs: Jobs = None
    scheduler: Annotated[str | None, typer.Option(metavar="ADDRESS", help="Scheduler of a Dask cluster that runs.")] = (
        None
    )
    results: Annotated[
        Path | None,
        typer.Option(metavar="FOLDER", help="Folder of the runs' numbers as they come; runs there are not repeated."),
    ] = None
    repeat: Annotated[int | None, typer.Option(metavar="K", min=0, help="Run number K of the campaign alone.")] = None

    def __bool__(self) -> bool:
        """Whether anything is said."""
        return any(value is not None for value in vars(self).values())


@dataclass(frozen=True)
class Columns:
    """How the columns of a log are read: which holds times, else the `period` between rows, and which are signals."""

    time: Annotated[str | None, typer.Option(help="The column of times, in the unit of the model's time.")] = None
    period: Annotated[
        float | None,
        typer.Option(help="The time between rows, in the unit of the model's time, where no column has times."),
    ] = None
    map_: Annotated[
        list[str] | None,
        typer.Option(
            "--map",
            metavar="SIGNAL=COLUMN",
            help="Which column is a signal, or what of columns, such as y='T1 + 273.15' or i='-[I (A)]'; repeat it.",
        ),
    ] = None


NO_RUNS = Runs()
NO_COLUMNS = Columns()


class _Set(TypedDict):
    """What a user may set of every step that a command makes: the options of a `Setting`."""

    form: Annotated[str | None, typer.Option(metavar="NAME", help="The form, in the place of the model's.")]
    method: Annotated[str | None, typer.Option(metavar="NAME", help="The method, in the place of the model's.")]
    dt: Annotated[float | None, typer.Option(help="The sampling period, in the model's unit of time.")]
    real: Annotated[
        Literal["float", "double"] | None,
        typer.Option(help="float or double; by default C is written in float and samples run in double."),
    ]
    guards: Annotated[
        Literal["all", "none"] | None,
        typer.Option(help="all, or none: the mathematics alone, without clamps, tests and restarts."),
    ]
    prefer: Annotated[
        Literal["speed", "flash"] | None,
        typer.Option(help="speed, or flash: what repeats in loops, a shorter program that takes longer."),
    ]
    parameters: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Values of parameters, as `hgogen fit` writes them.")
    ]
    tuning: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="Tunings, as `hgogen tune` writes them; of these the row to take is."),
    ]


# a value that a command takes, the class that holds its options, and whether they stand in its place or behind
GROUPS = ((Setting, _Set, False), (Runs, Runs, False), (Columns, Columns, True))


def engine_here(reader: Reader | None = None) -> "Engine":
    """The reader that is asked for, else C where there is a compiler, else Python, and says so."""
    if reader:
        return reader
    engine = native.engine()
    if engine == "python":
        note(str(native.NoCompilerWarning.__doc__))
    return engine


def one_or_all(trials: tuple["Trial", ...], name: str | None) -> tuple["Trial", ...]:
    """The trial of that name, by default all of them. Raises: `BadParameter`."""
    chosen = tuple(one for one in trials if name in (None, one.name))
    if not chosen:
        raise typer.BadParameter(f"{name!r} is none of {', '.join(one.name for one in trials)}", param_hint="--trial")
    return chosen


def numbers_by_name(texts: Iterable[str], option: str) -> dict[str, float]:
    """Numbers from texts such as "x=1,v=0". Raises: `typer.BadParameter`."""
    numbers = []
    for part in (part for text in texts for part in text.split(",")):
        name, _, number = part.partition("=")
        try:
            numbers.append((name.strip(), float(number)))
        except ValueError:
            raise typer.BadParameter(f"{part!r} must read NAME=NUMBER", param_hint=option) from None
    return once(numbers, option)


def once(pairs: Iterable[tuple[str, Value]], option: str) -> dict[str, Value]:
    """The values by name. Raises: `typer.BadParameter` for a name that is given twice."""
    values: dict[str, Value] = {}
    for name, value in pairs:
        if name in values:
            raise typer.BadParameter(f"{name} is given twice; leave one of them out", param_hint=option)
        values[name] = value
    return values


def numbers_in(text: str, what: str, option: str) -> tuple[float, ...]:
    """Numbers from a text such as "0.5,1"; `what` they must be. Raises: `typer.BadParameter`."""
    try:
        return tuple(map(float, text.split(",")))
    except ValueError:
        raise typer.BadParameter(f"{text!r} must be {what}", param_hint=option) from None


def names_in(text: str | None, option: str) -> tuple[str, ...]:
    """What a text such as "a,b" names, None nothing. Raises: `typer.BadParameter` for a text without a name."""
    names = tuple(part.strip() for part in (text or "").split(",") if part.strip())
    if text is not None and not names:
        raise typer.BadParameter(f"{text!r} holds no name; give some, or leave the option out", param_hint=option)
    return names


def horizons(text: str, option: str) -> tuple[int, ...]:
    """Numbers of samples ahead, from a text such as "1,5,25". Raises: `typer.BadParameter`."""
    try:
        ahead = tuple(int(part) for part in text.split(","))
    except ValueError:
        ahead = (0,)
    if min(ahead) < 1:
        raise typer.BadParameter(f"{text!r} must be positive whole numbers, such as 1,5,25", param_hint=option)
    return ahead
