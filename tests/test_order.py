"""The sections of a step called one by one: an update corrects once after each predict, in Python, C and Rust."""

import itertools
import subprocess
from pathlib import Path

import emitted
import numpy as np
import pytest
from test_rust import built

import hgogen as hg
from hgogen.program import Block, Place, walk
from hgogen.run import native

NAN = float("nan")
BIT = "OUT_OF_ORDER"
OTHERS = ("sure", "sure_columns", "noisy_inputs", "uneven", "joint_riccati", "joint_ukf", "joint_iterated_ekf", "timed")
ORDERED = (  # by name, as to make all steps takes seconds
    *(
        "fitzhugh_nagumo",
        "wider",
        "cascaded_tanks",
        "two",
        "angles",
        "gated",
        "gated_columns",
        "no_input",
        "window_held",
        "one_state",
        "many_states",
        "coupled",
        "for_flash",
    ),
    *("tunable", "sin", "x", "functions", "tables", "wide", "held", "removable", "unit_vector", "hyperbola", "varying"),
    "varying_moving",
)


def bits(step: hg.Step) -> list[str]:
    return [bit.name for bit in step.layout.bits]


def fresh(name: str, engine: str | None = None) -> hg.Step:
    """A step of its own memory, and one period on."""
    made = emitted.step(name)
    step = hg.sample(made.observer, made.method, dt=made.limits, engine=engine)
    step.predict(*[np.zeros(len(step.inputs))] * bool(step.inputs), **emitted.elapsed(step))
    return step


def samples(step: hg.Step) -> dict[str, float]:
    return {output.name: 0.25 for output in step.outputs}


# --- which steps -----------------------------------------------------------------------------------------------


@pytest.mark.ordinary("pendulum", "one_state", "redundant")
@pytest.mark.parametrize("name", emitted.STEPS)
def test_only_steps_whose_sections_are_called_apart_say_it(name: str) -> None:
    """One with rates says REPEATED and EARLY, one for late samples keeps them by their ages."""
    step = emitted.step(name)
    ordered = name in (*ORDERED, *OTHERS)
    assert (BIT in bits(step)) is ordered
    assert (step.code.separable and not step.code.timed and not step.ages) is ordered


@pytest.mark.ordinary("fitzhugh_nagumo", "one_state", "tunable")
@pytest.mark.parametrize("name", ORDERED)
def test_a_whole_step_never_says_it(name: str) -> None:
    step, draw = emitted.step(name), np.random.default_rng(3)
    u, y = draw.normal(size=(50, len(step.inputs))), draw.normal(size=(50, len(step.samples)))
    y[draw.random(y.shape) < 0.3] = NAN
    run = step.run(u, y, **emitted.elapsed(step))
    assert not any(BIT in step.flags(status) for status in run.status)


# --- once -------------------------------------------------------------------------------------------------------


@pytest.mark.ordinary("one_state", "tunable", "sin")
@pytest.mark.parametrize("name", ORDERED)
def test_a_second_update_does_not_correct(name: str) -> None:
    step = fresh(name)
    for output, value in samples(step).items():
        assert BIT not in step.update(**{output: value}).flags
        before = step.save()
        assert BIT in step.update(**{output: -value}).flags
        assert step.save() == before


@pytest.mark.ordinary("fitzhugh_nagumo", "one_state", "tunable")
@pytest.mark.parametrize("name", ORDERED)
def test_an_update_before_the_first_predict_does_not_correct(name: str) -> None:
    step = fresh(name)
    step.reset()
    before = step.save()
    for output, value in samples(step).items():
        assert BIT in step.update(**{output: value}).flags
    assert step.save() == before


def test_updates_of_several_outputs_are_each_once_in_any_order() -> None:
    for order in itertools.permutations(("y1", "y2")):
        step = fresh("two")
        assert [BIT in step.update(**{name: 0.1}).flags for name in (*order, *order)] == [False, False, True, True]
        step.predict(0.0)
        assert [BIT in step.update(**{name: 0.1}).flags for name in order] == [False, False]


@pytest.mark.parametrize("value", [NAN, 1e9])
def test_a_sample_that_is_not_used_leaves_room_for_one_that_is(value: float) -> None:
    step = fresh("fitzhugh_nagumo")
    assert BIT not in step.update(y=value).flags
    assert step.update(y=0.5).flags == ()
    assert BIT in step.update(y=0.5).flags


def test_a_whole_step_is_an_update_too() -> None:
    step = fresh("fitzhugh_nagumo")
    step(0.0, 0.5)
    assert BIT in step.update(y=0.5).flags


@pytest.mark.parametrize("spoiled", [2, 7])
def test_a_spoiled_memory_mends_at_the_next_predict(spoiled: int) -> None:
    step = fresh("fitzhugh_nagumo")
    step._kept.places[Place("state", "used_y")][0] = spoiled
    assert BIT in step.update(y=0.5).flags
    step.predict(0.0)
    assert step.update(y=0.5).flags == ()


def test_one_that_is_late_is_no_second_one() -> None:
    """A step for late samples takes several of an output in a period."""
    step = emitted.step("delayed")
    assert BIT not in {place.name for s in walk(step.code.program) if isinstance(s, Block) for place in s.writes}


# --- the same in C and Rust ---------------------------------------------------------------------------------------


def statuses(step: hg.Step, calls: str) -> list[int]:
    """What predict (p) and update (u) say, one after the other from a reset on."""
    step.reset()
    return [int((step.predict(0.0) if call == "p" else step.update(y=0.3)).status) for call in calls]


@pytest.mark.parametrize("calls", ["upuupu", "ppuupuu"])
def test_c_says_what_python_says(calls: str) -> None:
    if native.compiler() is None:
        pytest.skip("no C compiler")
    python, c = (statuses(fresh("one_state", engine), calls) for engine in ("python", "c"))
    assert c == python
    assert [bool(status & 1 << bits(emitted.step("one_state")).index(BIT)) for status in c] == {
        "upuupu": [True, False, False, True, False, False],
        "ppuupuu": [False, False, False, True, False, False, True],
    }[calls]


@pytest.mark.full
def test_rust_says_what_python_says(tmp_path: Path) -> None:
    step, calls = fresh("one_state", "python"), "upuupu"
    python = statuses(step, calls)
    lines = {
        "p": 'println!("{}", s.predict(&p, &Inputs { u: 0.0 }));',
        "u": 'println!("{}", s.update_y(&p, &Outputs { y: 0.3 }));',
    }
    body = "\n    ".join(lines[call] for call in calls)
    main = "use one_state::{Inputs, Outputs, Parameters, State};\nfn main() {\n"
    main += f"    let p = Parameters::new();\n    let mut s = State::new();\n    {body}\n}}\n"
    crate = hg.targets.rust(step, real="double", check=False)
    program = built({**crate, "main.rs": main}, "one_state", tmp_path)
    printed = subprocess.run([program], capture_output=True, text=True, check=True).stdout.split()
    assert list(map(int, printed)) == python
