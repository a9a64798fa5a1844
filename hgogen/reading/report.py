"""What was found in a log and what was done with it: counts, and a sentence for each."""

from collections.abc import Mapping
from dataclasses import dataclass


@dataclass(frozen=True)
class Report:
    """What was found in a log and what was done with it.

    `rows` of the file; `samples` on the grid of `dt`; `period`: typical time between rows; `unit`: of all times;
    `columns` by signal; by signal too, of the rows with a usable time: `missing` (empty cells) and
    `not_numbers` (NaN among them), both treated as missing samples; `covered`: those of them that share a
    grid point with another row and cost no sample; `absent`: samples without a number, in all, which is
    missing + not_numbers - covered + filled, but of an input that is averaged; `malformed`: rows with more
    cells than the header, left out; `untimed`: rows without a usable time, left out; `out_of_order`: rows
    earlier than one before them, sorted; `duplicates`: rows that repeat a time, merged; `surplus`: rows of
    other times at a grid point that
    has one, merged; `gaps`: pauses longer than 1.5 periods, the longest of `longest_gap`; `filled`: grid
    points without a row, given as missing samples; `shift`: the farthest a row was moved; `notes`:
    whatever else was decided on reading, or looks doubtful.
    """

    path: str
    rows: int
    samples: int
    dt: float
    period: float
    columns: Mapping[str, str]
    missing: Mapping[str, int]
    not_numbers: Mapping[str, int]
    covered: Mapping[str, int]
    absent: Mapping[str, int]
    malformed: int
    untimed: int
    out_of_order: int
    duplicates: int
    surplus: int
    gaps: int
    longest_gap: float
    filled: int
    shift: float
    unit: str
    notes: tuple[str, ...]

    def sentences(self) -> tuple[str, ...]:
        """What was found and what was done with it, a sentence each; only what there is."""
        period, dt = (f"{time:g} {self.unit}" for time in (self.period, self.dt))
        lines = [f"{self.rows} rows, one every {period}, became {self.samples} samples of {dt}"]
        for name, column in self.columns.items():
            for count, what in ((self.missing[name], "empty"), (self.not_numbers[name], "no finite number")):
                if count:
                    lines.append(f"{name} ({column}): cells that are {what}: {count}, taken as missing samples")
            if self.covered[name]:
                lines.append(
                    f"{name} ({column}): such cells beside another row's at a grid point: {self.covered[name]}"
                )
            if self.absent[name]:
                lines.append(f"{name} ({column}): samples without a number, in all: {self.absent[name]}")
        counted = (
            (self.malformed, "rows with more cells than the header: {}, left out"),
            (self.untimed, "rows without a usable time: {}, left out"),
            (self.out_of_order, "rows earlier than one before them: {}, sorted by time"),
            (self.duplicates, "rows that repeat a time: {}, merged; each column keeps its first number"),
            (
                self.surplus,
                "rows at a grid point that has one: {}, merged; the number nearest in time is kept",
            ),
            (self.gaps, f"gaps longer than 1.5 periods: {{}}, the longest {self.longest_gap:g} {self.unit}"),
            (self.filled, "grid points without a row: {}, given as missing samples"),
        )
        lines += [text.format(count) for count, text in counted if count]
        if self.shift > 1e-6 * self.dt:
            lines.append(f"rows were moved to the nearest grid point, by {self.shift:.3g} {self.unit} at most")
        return (*lines, *self.notes)
