"""The status word: 32 bits, 64 where they are needed, and a limit that is told at once, with what takes the bits."""

from pathlib import Path

import emitted
import numpy as np
import pytest
from emitted import files, run, step, tool

import hgogen as hg
from hgogen import step as steps
from hgogen.emit.interface import status_type
from hgogen.run import native
from hgogen.step import BadStep
from hgogen.stepping.guards import certain_bits

NAN = float("nan")
needs_compiler = pytest.mark.skipif(native.compiler() is None, reason="there is no C compiler")


def observer(outputs: int, inputs: int = 0, ranged: bool = True) -> hg.Observer:
    """A filter of two states with so many outputs and inputs."""
    a, b = emitted.signals("a b", -2, 2)
    y = emitted.signals(" ".join(f"y{i}" for i in range(outputs)))
    u = [hg.Signal(f"u{i}", low=-1, high=1) if ranged else hg.Signal(f"u{i}") for i in range(inputs)]
    read = [a if i % 2 else b for i in range(outputs)]
    plant = hg.System("bits", states=(a, b), inputs=u, outputs=y, flow=[sum(u) - a, -b], output=read)
    return hg.observers.riccati(hg.forms.original(plant), Q=[1] * 2, R=[1] * outputs)


def test_what_is_too_wide_is_refused_before_anything_is_made(monkeypatch: pytest.MonkeyPatch) -> None:
    """The number of bits, what takes them, and a way out that works."""
    wide = observer(31, 2)
    with monkeypatch.context() as patch:
        for made in ("_pieces", "_lengths", "_assembled"):
            patch.setattr(steps, made, lambda *_: pytest.fail("made"))
        said = "bits with 66 status bits or more has more than 64: MISSING for 31 signals, REJECTED for 31 signals, "
        with pytest.raises(BadStep, match=said + "REUSED for 2 signals, CLAMPED for 2 signals; drop outputs, inputs"):
            hg.sample(wide, dt=0.01)
        with pytest.raises(BadStep, match=r"with 65 .* LATE for 13 signals, EARLY for 13 signals, REPEATED for 13"):
            hg.sample(observer(13), dt=0.01, periods={"y1": 0.02})
    assert not hg.sample(wide, dt=0.01, guards="none").layout.bits


@pytest.mark.full
@pytest.mark.parametrize("made", [lambda: observer(30), lambda: hg.delayed(observer(13, 1), y0=2, y1=3)])
def test_what_shows_when_it_is_made_is_refused_with_the_same_words(made) -> None:
    with pytest.raises(BadStep, match=r"more than 64: MISSING for .* for the whole step; drop outputs"):
        hg.sample(made(), dt=0.01)


@pytest.mark.ordinary("fitzhugh_nagumo", "pendulum", "cascaded_tanks", "two", "bank")
@pytest.mark.parametrize("name", emitted.STEPS)
def test_what_is_counted_at_the_door_is_raised(name: str) -> None:
    """So nothing is refused there that would have had room."""
    made = step(name)
    dated = [str(y) for y in made.outputs] if made.code.timed else dict(made.observer.delays)
    wanted = certain_bits(made.outputs, made.inputs, dated) if made.clock.guards == "all" else []
    assert set(wanted) <= {bit.place.name for bit in made.layout.bits}


@pytest.mark.full
@needs_compiler
@pytest.mark.parametrize("real", ["float", "double"])
def test_the_highest_bits_are_told_by_every_reader(real: str) -> None:
    """By the compiled step, in Python, in lanes and in CasADi."""
    made = step("wider").rebuilt(real=real)
    assert made.layout.word == np.uint64
    u, y = np.zeros((4, 2)), np.zeros((4, 16))
    y[1, 15], u[2, 1], y[3, 0] = NAN, 9, NAN
    wanted = [(), ("MISSING_Y15",), ("CLAMPED_W",), ("MISSING_Y0",)]
    for engine in ("c", "python"):
        made.reset()
        run = made.run(u=u, y=y, engine=engine)
        assert run.status.dtype == np.uint64
        assert [made.flags(status) for status in run.status] == wanted
        made.reset()
        assert [made(each, sample).flags for each, sample in zip(u, y, strict=True)] == wanted
    made.reset()
    assert np.array_equal(made.run_many(u=u, y=np.stack([y] * 3)).status, np.stack([run.status] * 3))
    assert max(run.status) > 2**32
    if real == "double":
        known = hg.targets.casadi(made)
        status = known.step(known.memory.initial, u[2], y[2], known.p.initial)[2]
        assert known.flags(status) == ("CLAMPED_W",)


@pytest.mark.full
@needs_compiler
def test_late_samples_have_bits_beyond_32() -> None:
    made = hg.sample(hg.delayed(observer(9, 1), y8=2), dt=0.01)
    assert made.layout.word == np.uint64
    y = np.zeros((4, len(made.samples)))
    y[3, -1] = 9  # older than the last reset
    runs = [(made.reset(), made.run(u=np.full(4, 5.0), y=y, engine=engine))[1] for engine in ("c", "python")]
    assert {"CLAMPED_U0", "LATE_Y8"} <= set(made.flags(runs[0].status[3]))
    assert np.array_equal(runs[0].status, runs[1].status)


@pytest.mark.parametrize("compiler", [("cc",), ("avr-gcc", "-mmcu=atmega2560")], ids=["cc", "avr-gcc"])
@pytest.mark.parametrize("name", ["pendulum", "wide", "wider"])
def test_a_mask_of_other_bits_leaves_the_highest(name: str, compiler: tuple[str, ...], tmp_path: Path) -> None:
    """A bit has the type of the status, so that its complement is as wide, where an int has 16 bits too."""
    made, upper = step(name), step(name).name.upper()
    lowest, *_, highest = (f"{upper}_{bit.name}" for bit in made.layout.bits)
    lines = [f'#include "{made.name}.h"', f"typedef char left[((~{lowest} & {highest}) == {highest}) ? 1 : -1];"]
    lines += [f"typedef char wide[(sizeof({lowest}) == sizeof({status_type(made)})) ? 1 : -1];"]
    (tmp_path / f"{made.name}.h").write_text(files(name)[f"{made.name}.h"])
    (tmp_path / "mask.c").write_text("\n".join(lines) + "\n")
    run([tool(compiler[0]), *compiler[1:], "-std=c99", "-Wall", "-Werror", "-c", "mask.c"], tmp_path)
