"""What the emitted C of a step costs on a Cortex-M4F."""

import tempfile
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import numpy as np

from hgogen.emit.syntax import Real
from hgogen.extras import qemu, texts
from hgogen.extras.price import digest
from hgogen.step import Step
from hgogen.target import write

FLAGS = ("-O2", *qemu.M4F, "-ffp-contract=off")


@dataclass(frozen=True)
class Costs:
    """What a step costs, and by what that was measured."""

    quiet: Annotated[int, "instructions of a step, the mean of calm samples"]
    worst: Annotated[int, "instructions of a step, the worst of a hostile record"]
    flash: Annotated[int, "bytes of flash"]
    ram: Annotated[int, "bytes of state and parameters"]
    stack: Annotated[int, "bytes of stack, the deepest of all samples and of spoiled memory"]
    real: Annotated[Real, "working precision"]
    machine: Annotated[str, "the processor"]
    compiler: Annotated[str, "version of the compiler"]
    flags: Annotated[str, "options of the compiler"]
    emulator: Annotated[str, "version of the emulator"]
    source: Annotated[str, "digest of the C, by which it is known whether the costs are of it"]


def measured(step: Step, files: Mapping[str, str], rows: np.ndarray, real: Real) -> Costs:
    """The costs of the C of a step, `files` of the target c99, over rows (N, m + p) of what it is given; a hostile
    record is made of them, and rows that are missing are the first again.

    Raises: `NoBoard`, `BoardFailed`.
    """
    qemu.demand_board()
    calm = rows[np.arange(texts.ROWS // 2) % len(rows)]
    record = np.concatenate([calm, texts.hostile(calm)])
    head = texts.head(record, real, len(step.states), len(calm))
    sources = {name: files[name] for name in (f"{step.name}.h", f"{step.name}.c")}
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        write(sources, folder)
        flash = qemu.compiled(f"{step.name}.c", folder, FLAGS)
        main = head + texts.counting(texts.driver(step))
        numbers = qemu.ran(qemu.linked(main, [f"{step.name}.o"], texts.harness(), folder, FLAGS))
    return Costs(
        flash=flash,
        real=real,
        machine=qemu.NAME,
        compiler=qemu.version(qemu.COMPILER),
        flags=" ".join(FLAGS),
        emulator=qemu.version(qemu.EMULATOR),
        source=digest(files[f"{step.name}.c"]),
        **numbers,
    )
