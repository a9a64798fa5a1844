"""The recorded samples of a self-check: a plant inside its ranges, then every guard, and what that finds in C."""

from functools import cache

import numpy as np
import pytest
from plants import MODELS

from hgogen.emit.pystep import PLACED, Vectors, record_vectors
from hgogen.model import load
from hgogen.run import native
from hgogen.step import Step
from hgogen.targets import c99


@cache
def step(name: str) -> Step:
    return load(next(MODELS.glob(f"{name}.*"))).step()


@cache
def vectors(name: str) -> Vectors:
    return record_vectors(step(name), "float")


def raised(name: str) -> dict[str, list[int]]:
    """The samples at which each status bit is raised."""
    status = vectors(name).status
    return {bit.name: np.flatnonzero(status >> k & 1).tolist() for k, bit in enumerate(step(name).layout.bits)}


FEW = ("battery", "pendulum", "quadruple_tank", "series_dc_motor")


@pytest.mark.parametrize("name", FEW)
def test_the_estimate_is_inside_the_declared_ranges_at_most_samples(name: str) -> None:
    low, high = np.array([s.interval for s in step(name).states]).T
    x = vectors(name).values[: min(PLACED), : len(low)]
    assert ((x > low) & (x < high)).all(axis=1).mean() > 0.9
    assert (np.ptp(x, axis=0) > 1e-3 * (high - low)).all()  # each state moves


@pytest.mark.parametrize("name", FEW)
def test_every_guard_of_a_sample_acts_and_so_does_recovery(name: str) -> None:
    bits = raised(name)
    for y in step(name).outputs:
        assert bits[f"MISSING_{y}".upper()] == [20, 25]  # not a number, and infinite
        assert 30 in bits[f"REJECTED_{y}".upper()]
        assert 60 not in bits[f"REJECTED_{y}".upper()]  # hardly plausible
    for u in step(name).inputs:
        assert bits[f"REUSED_{u}".upper()] == [40]
        assert bits[f"CLAMPED_{u}".upper()] == [45]
    for bit in ("OUTSIDE_BOX", "RESTARTED", "RESTARTED_FROM_SAMPLE", "STATE_LIMITED"):
        assert bits[bit] or (name, bit) == ("pendulum", "STATE_LIMITED"), bit
    assert {55, 58} <= set(bits["RESTARTED_FROM_SAMPLE"])  # by errors of either sign
    assert bits["PROJECTED_ONTO_RANGES"] == [52] or name in ("battery", "series_dc_motor")


def test_a_plant_that_leaves_its_ranges_begins_anew() -> None:
    """The series motor speeds up, from whichever phase of its input."""
    assert [k for k in vectors("series_dc_motor").placed if k < min(PLACED)] == [0, 17, 29]
    assert [k for k in vectors("pendulum").placed if k < min(PLACED)] == [0]


# gross bugs that act inside the declared ranges alone, where the arguments of these functions are not clamped
SEEDED = [
    ("quadruple_tank", "return (x < 1.1754944e-38f) ?", "return (x > 1.1f) ? 2.0f*t16 : (x < 1.1754944e-38f) ?"),
    ("battery", "return (x < 1.1754944e-38f) ?", "return (x > 0.051f) ? -2.9f : (x < 1.1754944e-38f) ?"),
    ("battery", "saved[k + 8u] = bytes[k];", "saved[k + 8u] = (unsigned char)(bytes[k] ^ 1u);"),
    ("battery", "s->z[0] = battery_keep(z1 + t6*t8,", "s->z[0] = battery_keep(z1 - t6*t8,"),
]


@pytest.mark.skipif(native.compiler() is None, reason="no C compiler")
@pytest.mark.full
@pytest.mark.parametrize(("name", "right", "wrong"), SEEDED)
def test_a_bug_inside_the_ranges_is_caught(name: str, right: str, wrong: str) -> None:
    files = c99(step(name), real="float")
    assert native.run_check(files, (f"-D{name.upper()}_EXACT",)) == f"{name}: 64 samples as recorded\n"
    spoiled = {**files, f"{name}.c": files[f"{name}.c"].replace(right, wrong)}
    assert spoiled[f"{name}.c"] != files[f"{name}.c"]
    with pytest.raises(native.CheckFailed, match="differs"):
        native.run_check(spoiled, ())
