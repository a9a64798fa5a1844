"""The names of status bits: capitals, one for each, the same in every language, and their words name the signal."""

import itertools
import re
from pathlib import Path

import emitted
import numpy as np
import pytest

import hgogen as hg
from hgogen.program import Bit, in_capitals
from hgogen.run import native
from hgogen.run.prediction import rejected

NAN = float("nan")
KINDS = ("MISSING", "REJECTED", "REUSED", "CLAMPED", "LATE", "EARLY", "REPEATED", "UNDATED")


def by_case() -> hg.Step:
    """Two outputs and two inputs whose names differ by their case alone, and one that has the number of another."""
    x, z, w = emitted.signals("x z w")
    v, V, v_2, q, Q = emitted.signals("v V v_2 q Q")
    plant = hg.System(
        "by_case", states=(x, z, w), inputs=(q, Q), outputs=(v, V, v_2), flow=[q - x, Q - z, -w], output=[x, z, w]
    )
    return hg.sample(hg.observers.riccati(hg.forms.original(plant), Q=[1] * 3, R=[1] * 3), dt=0.01)


@pytest.mark.ordinary("fitzhugh_nagumo", "pendulum", "cascaded_tanks", "two", "bank")
@pytest.mark.parametrize("name", emitted.STEPS)
def test_names_are_capitals_and_words_name_the_signal_as_declared(name: str) -> None:
    step = emitted.step(name)
    names = [bit.name for bit in step.layout.bits]
    assert len(set(names)) == len(names)
    assert all(re.fullmatch(r"[A-Z][A-Z0-9_]*", each) for each in names)
    for signal, kind in itertools.product((*step.outputs, *step.inputs), KINDS):
        for bit in (bit for bit in step.layout.bits if bit.place.name == f"{kind}_{signal.name}"):
            assert re.search(rf"(?<!\w){signal.name}(?!\w)", bit.meaning)


def test_signals_that_differ_by_case_have_bits_of_their_own() -> None:
    """V is V in capitals; v has a number that v_2 has not."""
    names = {bit.place.name: bit.name for bit in by_case().layout.bits}
    assert names["MISSING_V"] == "MISSING_V"
    assert names["MISSING_v"] == "MISSING_V_2"
    assert names["MISSING_v_2"] == "MISSING_V_2_2"
    assert (names["CLAMPED_q"], names["CLAMPED_Q"]) == ("CLAMPED_Q_2", "CLAMPED_Q")


def test_a_name_in_capitals_is_kept_wherever_it_stands() -> None:
    bits = [Bit(name, "", "") for name in ("A_b", "A_B", "A_B_2", "C_d")]
    assert [bit.name for bit in in_capitals(bits)] == ["A_B_3", "A_B", "A_B_2", "C_D"]
    assert in_capitals(in_capitals(bits)) == in_capitals(bits)


@pytest.mark.parametrize("engine", ["c", "python"])
def test_each_is_raised_by_its_own_signal(engine: str) -> None:
    if engine == "c" and native.compiler() is None:
        pytest.skip("no C compiler")
    step = by_case()
    run = step.run(np.array([[0, NAN], [NAN, 0]]), np.array([[NAN, 0, 0], [0, NAN, 0]]), engine=engine)
    assert [set(step.flags(status)) for status in run.status] == [
        {"MISSING_V_2", "REUSED_Q"},
        {"MISSING_V", "REUSED_Q_2"},
    ]


def test_what_reads_bits_reads_those_of_the_signal() -> None:
    step = by_case()
    y = np.array([[0, 0, 0], [0, 1e9, 0], [1e9, 0, 0]])
    assert rejected(step, step.run(np.zeros((3, 2)), y), y).tolist() == (y > 1).tolist()


@pytest.mark.full
def test_the_macros_and_the_constants_are_the_names(tmp_path: Path) -> None:
    step = by_case()
    wanted = [bit.name for bit in step.layout.bits]
    header = hg.targets.c99(step, check=False)["by_case.h"]
    assert re.findall(r"^#define BY_CASE_(?!READY)(\w+) +(?:UINT\d\d_C\()?0x", header, re.MULTILINE) == wanted
    crate = hg.targets.rust(step, check=False)["by_case.rs"]
    assert wanted[-2:] == ["UNINITIALISED", "NO_PARAMETERS"]  # of memory that nothing has made, which these have not
    assert re.findall(r"pub const (\w+): u32", crate) == wanted[:-2]
    assert hg.targets.casadi(step).bits == tuple(wanted[:-2])
    emitted.compiled(emitted.tool("gcc"), hg.targets.c99(step), tmp_path, "-DBY_CASE_EXACT")
