"""What `tune` limits: each parameter to its range by one rule, in a table of rows where that is the shorter text."""

import re
import subprocess
from pathlib import Path

import emitted
import numpy as np
import pytest
from exact import machine
from test_rust import built

import hgogen as hg
from hgogen.program import INF, Block, Field, Limit, Place
from hgogen.stepping.guards import limit_parameters

ABSURD = (np.nan, np.inf, -np.inf, 3.1e38, -1e30, 0.0, -0.0)
TABLED = ("fitzhugh_nagumo", "cascaded_tanks", "bank", "wide", "sin")
WRITTEN_OUT = ("pendulum", "one_state", "tunable")


def parameters(step: hg.Step) -> list[tuple[str, Field]]:
    kinds = (("plant", step.layout.plant), ("gain", step.layout.gains))
    return [(kind, field) for kind, fields in kinds for field in fields]


def ruled(value: np.float32, low: float, high: float, nominal: float) -> np.float32:
    """The rule in plain words."""
    if not np.isfinite(value) or abs(value) > 3e38:
        return np.float32(nominal)
    return min(max(value, np.float32(low)), np.float32(high))


@pytest.mark.ordinary("pendulum", "two", "one_state")
@pytest.mark.parametrize("name", emitted.STEPS)
def test_every_element_is_limited_once_by_the_rule(name: str) -> None:
    step, draw = emitted.step(name), np.random.default_rng(8)
    memory = machine(step, "float")
    outside = 0
    for _ in range(20):
        before = {}
        for kind, field in parameters(step):
            drawn = draw.choice((*ABSURD, *field.initial), field.size).astype(np.float32)
            before[kind, field.name] = memory.memory[Place(kind, field.name)][:] = drawn
        status = memory.tune()
        beyond = False
        for kind, field in parameters(step):
            for k, ((low, high), nominal) in enumerate(zip(field.box, field.initial, strict=True)):
                value = before[kind, field.name][k]
                assert memory.memory[Place(kind, field.name)][k] == ruled(value, low, high, nominal)
                beyond |= not np.float32(low) <= value <= np.float32(high)
        assert bool(status) is beyond
        outside += beyond
    assert outside > 0


@pytest.mark.parametrize("name", TABLED)
def test_many_are_rows_of_a_table(name: str) -> None:
    """In the order of the parameters; each in its row with its range and its nominal value."""
    step = emitted.step(name)
    tune = emitted.files(name)[f"{step.name}.c"].split(f"unsigned {step.name}_tune(")[-1]
    rows = re.findall(r"\{(\S+)f, (\S+)f, (\S+)f\}, /\* p->(\S+) \*/", tune)
    limits = [
        (low, high, nominal, f"{kind}.{field.name}{f'[{k}]' if field.size > 1 else ''}")
        for kind, field in parameters(step)
        for k, ((low, high), nominal) in enumerate(zip(field.box, field.initial, strict=True))
    ]
    assert [row[3].replace("I_", "I") for row in rows] == [limit[3] for limit in limits]
    numbers = np.array([[float(value) for value in row[:3]] for row in rows], np.float32)
    np.testing.assert_array_equal(numbers, np.array([limit[:3] for limit in limits], np.float32))
    assert re.findall(r"&p->([^,\s}]+)", tune)[: len(rows)] == [row[3] for row in rows]
    assert tune.count("PARAMETER_LIMITED") == 1


@pytest.mark.parametrize("name", WRITTEN_OUT)
def test_few_are_written_out(name: str) -> None:
    step = emitted.step(name)
    assert "nominal;" not in emitted.files(name)[f"{step.name}.c"]


def test_a_range_without_ends_is_no_row() -> None:
    fields = tuple(Field(name, (1.0,), low=(low,), high=(2.0,)) for name, low in (("a", 0.0), ("b", -INF), ("c", 0.0)))
    blocks = limit_parameters((), fields, ())
    assert [block.title for block in blocks if isinstance(block, Block)] == [f"{name} in its range" for name in "abc"]
    (block,) = limit_parameters((), (*fields[::2], *fields[:1]), ())
    assert isinstance(block, Block)
    assert block.limits[1] == Limit(Place("gain", "c"), 0, 1, 0.0, 2.0, 1.0)


_MAIN = """
use {name}::{{Parameters}};
const VALUES: [[u32; {width}]; {count}] = [{rows}];
fn main() {{
    for row in VALUES.iter() {{
        let mut p = Parameters::new();
        {sets}
        let status = p.tune();
        println!("{{}} {shown}", status, {values});
    }}
}}
"""


@pytest.mark.parametrize("name", ["fitzhugh_nagumo", "tunable", "sin"])
def test_rust_limits_to_the_same_bits(name: str, tmp_path: Path) -> None:
    step, draw = emitted.step(name), np.random.default_rng(9)
    fields = parameters(step)
    members = [
        f"p.{kind}.{field.name}{f'[{k}]' if field.size > 1 else ''}"
        for kind, field in fields
        for k in range(field.size)
    ]
    count, memory = 60, machine(step, "float")
    nominal = np.array([value for _, field in fields for value in field.initial], np.float32)
    scale = draw.uniform(-0.5, 2.5, (count, len(members))).astype(np.float32)
    drawn = np.where(draw.random(scale.shape) < 0.3, draw.choice(ABSURD, scale.shape), nominal * scale)
    values = drawn.astype(np.float32)
    text = _MAIN.format(
        name=step.name,
        width=len(members),
        count=count,
        rows=", ".join(str(row.view(np.uint32).tolist()) for row in values),
        sets="\n        ".join(f"{member} = f32::from_bits(row[{j}]);" for j, member in enumerate(members)),
        shown=" ".join(["{}"] * len(members)),
        values=", ".join(f"{member}.to_bits()" for member in members),
    )
    crate = hg.targets.rust(step, check=False)
    program = built({**crate, "main.rs": text}, step.name, tmp_path)
    printed = subprocess.run([program], capture_output=True, text=True, check=True).stdout.splitlines()
    for row, line in zip(values, printed, strict=True):
        start = 0
        for kind, field in fields:
            memory.memory[Place(kind, field.name)][:] = row[start : start + field.size]
            start += field.size
        status = memory.tune()
        after = np.concatenate([memory.memory[Place(kind, field.name)] for kind, field in fields])
        assert line.split() == [str(status), *map(str, after.view(np.uint32).tolist())]
