"""The command `cost`: what a model's emitted C costs on a Cortex-M4F, and whether it keeps to limits."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, ClassVar

import typer

from hgogen import targets
from hgogen.commands import trial_runs
from hgogen.commands.command import ModelReport, command
from hgogen.commands.options import ModelArgument, Tuned
from hgogen.commands.output import Folder, Written, headed, json_text, named
from hgogen.commands.packing import COSTS, Prefix
from hgogen.commands.process import note
from hgogen.emit.naming import demand_prefix, prefixed
from hgogen.errors import HgogenError
from hgogen.extras.costs import Costs, measured
from hgogen.extras.qemu import demand_board
from hgogen.model import load
from hgogen.modelfiles.setting import AS_WRITTEN, Setting
from hgogen.sentence import encoded
from hgogen.trial import rows_given

_MEANINGS = {
    "quiet": "instructions of a step, calm",
    "worst": "instructions of a step, the worst of a hostile record",
    "flash": "flash, bytes",
    "ram": "RAM, bytes of state and parameters",
    "stack": "stack, bytes",
}


@dataclass(eq=False)
class TooDear(HgogenError):
    """Costs above the limits that were asked for: each with what it is and its limit."""

    status: ClassVar[int] = 1
    over: tuple[tuple[str, int, int], ...]

    def __str__(self) -> str:
        return "; ".join(f"{_MEANINGS[name]}: {value}, more than {limit}" for name, value, limit in self.over)


def _most(what: str) -> typer.models.OptionInfo:
    option: typer.models.OptionInfo = typer.Option(metavar="N", min=0, help=f"Fail where {what} is more.")
    return option


@dataclass(frozen=True)
class CostReport(ModelReport):
    """The costs of a model's C."""

    json_keys = "model *costs files"

    costs: Costs
    files: Written
    title: str
    limits: Mapping[str, int | None]

    def tables(self) -> Iterator[Any]:
        """A row for each cost."""
        rows = ((meaning, str(getattr(self.costs, key))) for key, meaning in _MEANINGS.items())
        yield headed(self.title, "what", "how much", numbers=1, rows=rows)
        yield f"{self.costs.compiler} {self.costs.flags}\n"

    def demand(self) -> None:
        """Raise `TooDear` where a cost is above its limit."""
        asked = [(key, getattr(self.costs, key), limit) for key, limit in self.limits.items() if limit is not None]
        if over := tuple((key, value, limit) for key, value, limit in asked if value > limit):
            raise TooDear(over)


@command(CostReport)
def cost_(
    model: ModelArgument,
    observer: Tuned = None,
    setting: Setting = AS_WRITTEN,
    out: Annotated[Path, typer.Option("--out", "-o", help="Folder that holds one folder a model.")] = Path("generated"),
    name: Prefix = None,
    max_flash: Annotated[int | None, _most("the step's code, in bytes,")] = None,
    max_ram: Annotated[int | None, _most("its state with the parameters, in bytes,")] = None,
    max_stack: Annotated[int | None, _most("its stack, in bytes,")] = None,
    max_instructions: Annotated[int | None, _most("the worst number of instructions of a step")] = None,
) -> CostReport:
    """Measure what the C of a model costs on a Cortex-M4F: compiled by arm-none-eabi-gcc and run in QEMU over the
    model's trial, or one made of its ranges, without jumps, and over the same record with gaps, jumps and numbers that
    are none. Writes MODEL/cost.json below --out, of which `hgogen generate --for` tells in the folder's README.
    """
    demand_prefix(name)
    demand_board()
    loaded = load(model).set(setting)
    folder = Folder(out, name or named(loaded, observer))
    folder.demand(COSTS)
    note(*loaded.notes)
    made, trial, real = loaded.step(observer), trial_runs.trials(loaded)[0], loaded.setting.real or "float"
    step = prefixed(made, name) if name else made
    costs = measured(step, targets.c99(step, real=real, check=False), rows_given(made, trial), real)
    paths = folder.write({COSTS: json_text({"model": loaded.name, **encoded(costs)}) + "\n"})
    limits = {"flash": max_flash, "ram": max_ram, "stack": max_stack, "worst": max_instructions}
    return CostReport(loaded.path, costs, tuple(paths), f"{step.name} in {real} on a {costs.machine}", limits)
