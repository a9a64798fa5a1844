"""The benchmarks: the mathematics of the peers is that of the steps, and steps cost what is recorded."""

import math
import sys
from pathlib import Path

import numpy as np
import pytest

sys.path.append(str(Path(__file__).with_name("benchmarks")))

import cases
import in_python
import mathematics
import peers
import programs
import recorded
from emitted import tool


@pytest.mark.parametrize("name", ["default", "rk4_covariance", "two_outputs"])
def test_the_mathematics_is_that_of_the_step(name: str) -> None:
    """On a record without faults, to rounding."""
    case = cases.CASES[name]()
    rows, m = case.quiet[:200], len(case.inputs)
    sample = mathematics.sample(case, mathematics.model(case, math))
    w, ends = peers.start(case), []
    for before, row in zip(rows[:-1].tolist(), rows[1:].tolist(), strict=True):
        w = sample(w, before, row)
        ends.append(w[: case.n])
    run = case.step.run(u=rows[:, :m], y=rows[:, m:], engine="python")
    assert not run.status.any()
    in_python.demand_agreement(name, np.array(ends), run.x[1:], 1e-12)
    with pytest.raises(in_python.Differs, match="differs from the step by"):
        in_python.demand_agreement(name, np.array(ends) + 1e-6, run.x[1:], 1e-12)


def test_a_text_of_c_in_double_becomes_one_of_float() -> None:
    text = "w0=(2.*sin(a0[1])+1e-3*fabs(x1.y)-5.0000000000000000e-01); k = 12; cosine(3)"
    assert peers.single(text) == "w0=(2.f*sinf(a0[1])+1e-3f*fabsf(x1.y)-5.0000000000000000e-01f); k = 12; cosine(3)"


def test_what_costs_more_or_less_is_said() -> None:
    known = {"x86": 1000, "text": 100, "stack": 100}
    more, less = recorded.changes(known, {"x86": 1040, "text": 103, "stack": 90})
    assert more == "x86: 1040, 4.0% more than the 1000 that are recorded"
    assert less == "stack: 90, less than the 100 that are recorded; record it by python tests/benchmarks --record"
    assert list(recorded.changes(known, known)) == []


@pytest.mark.slow
@pytest.mark.parametrize("name", recorded.SIX)
def test_a_step_costs_what_is_recorded(name: str, tmp_path: Path) -> None:
    for needed in recorded.compilers():
        tool(needed)
    table = recorded.committed().get(recorded.key())
    if table is None:
        pytest.skip(f"the costs are recorded by other compilers than {recorded.key()}")
    assert list(recorded.changes(table[name], recorded.costs(name, tmp_path))) == []


@pytest.mark.slow
@pytest.mark.parametrize("peer", ["casadi", "sympy"])
def test_a_peer_has_the_estimates_of_the_step(peer: str, tmp_path: Path) -> None:
    """The programs that are measured, in double."""
    tool("gcc")
    case = cases.CASES["default"]()
    parts = programs.peer(peers.source(peer, case, "double"), peers.start(case), "double")
    both = [
        programs.estimates(programs.built(case, each, "double", tmp_path / where, False, ("-O2",)).path, 1000)
        for where, each in (("peer", parts), ("ours", programs.ours(case, "double")))
    ]
    in_python.demand_agreement(peer, *both, 1e-12)
