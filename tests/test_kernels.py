"""The kernels on P = L D L' against what they stand for, computed densely."""

import ctypes
import subprocess
import tempfile
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hgogen.discretisation import kernels
from hgogen.emit.portable import kernels as kernels_of
from hgogen.emit.syntaxes import C
from hgogen.run import native

EPS = float(np.finfo(float).eps)
sizes, seeds = st.integers(1, 9), st.integers(0, 2**32 - 1)


def factors(rng: np.random.Generator, n: int, decades: float) -> tuple[np.ndarray, np.ndarray]:
    """L and D, of which D spreads over twice as many decades."""
    return np.tril(rng.standard_normal((n, n)), -1) + np.eye(n), 10 ** rng.uniform(-decades, decades, n)


def lower(columns: np.ndarray) -> np.ndarray:
    return np.asarray(np.tril(columns.T, -1) + np.eye(len(columns)))


def assert_is(columns: np.ndarray, d: np.ndarray, P: np.ndarray, size: np.ndarray) -> None:
    """L D L' is P, but for some n^2 roundings of `size`, the diagonal of what was added up."""
    error = np.abs(lower(columns) @ np.diag(d) @ lower(columns).T - P) / np.sqrt(np.outer(size, size))
    assert error.max() < 100 * len(d) ** 2 * EPS


@given(sizes, seeds, st.data())
@settings(deadline=None, max_examples=100)
def test_a_banded_product_becomes_triangular_again(n: int, seed: int, data: st.DataObject) -> None:
    """Phi L, Phi with a band above its diagonal: every bit above L's diagonal is 0, and every D positive."""
    rng = np.random.default_rng(seed)
    (L, d), band = factors(rng, n, 2), data.draw(st.integers(1, max(1, n - 1)))
    Phi = np.tril(rng.standard_normal((n, n)), band)
    columns, after = (Phi @ L).T.copy(), d.copy()
    kernels.triangularise(columns, after, band)
    assert np.array_equal(columns.T, lower(columns))
    assert (after > 0).all()
    P = Phi @ L @ np.diag(d) @ L.T @ Phi.T
    assert_is(columns, after, P, np.diag(np.abs(Phi @ L) @ np.diag(d) @ np.abs(Phi @ L).T))


def test_a_pivot_of_zero_is_no_division_by_zero() -> None:
    """The rows of Phi L exchanged."""
    columns, d = np.array([[0.0, 1.0], [1.0, 0.0]]), np.array([2.0, 3.0])
    kernels.triangularise(columns, d, 1)
    assert np.array_equal(columns, np.eye(2))
    assert np.array_equal(d, [3.0, 2.0])


@given(sizes, seeds)
@settings(deadline=None, max_examples=60)
def test_noise_is_added_to_the_diagonal(n: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    (L, d), w = factors(rng, n, 2), 10 ** rng.uniform(-4, 2, n) * rng.integers(0, 2, n)
    columns, after, P = L.T.copy(), d.copy(), L @ np.diag(d) @ L.T + np.diag(w)
    kernels.add(columns, after, w)
    assert_is(columns, after, P, np.diag(P))
    assert (after >= d).all()


@given(sizes, seeds, st.data())
@settings(deadline=None, max_examples=60)
def test_a_row_that_reads_few_states_changes_no_more_than_it_must(n: int, seed: int, data: st.DataObject) -> None:
    """What the whole row changes, which multiplies and divides other D by r."""
    rng = np.random.default_rng(seed)
    (L, d), read, r = factors(rng, n, 2), data.draw(st.integers(0, n)), np.array([10 ** rng.uniform(-2, 2)])
    c = np.where(np.arange(n) < read, rng.standard_normal(n), 0.0)
    results = []
    for count in (read, n):
        columns, after, gain = L.T.copy(), d.copy(), np.zeros(n)
        kernels.correct(columns, after, c, r, gain, count)
        results.append((columns, after, gain))
    assert all(np.allclose(few, whole, rtol=2 * EPS, atol=0) for few, whole in zip(*results, strict=True))


@given(sizes, seeds, st.data())
@settings(deadline=None, max_examples=60)
def test_rows_and_columns_are_cleared_and_variances_replaced(n: int, seed: int, data: st.DataObject) -> None:
    """P of the other states stays, within rounding; its rows before the first that is cleared bit for bit."""
    rng = np.random.default_rng(seed)
    (L, d), w = factors(rng, n, 2), 10 ** rng.uniform(-4, 2, n) * rng.integers(0, 2, n)
    columns, after, cleared = L.T.copy(), d.copy(), w > 0
    P = L @ np.diag(d) @ L.T
    diagonal = np.diag(P).copy()
    P[cleared, :] = P[:, cleared] = 0
    P[cleared, cleared] = w[cleared]
    kernels.decouple(columns, after, w)
    assert (after > 0).all()
    assert_is(columns, after, P, np.maximum(diagonal, w))
    assert not lower(columns)[:, cleared][~np.eye(n, dtype=bool)[:, cleared]].any()
    first = int(np.argmax(cleared)) if cleared.any() else n
    assert np.array_equal(after[:first], d[:first])


@given(sizes, seeds)
@settings(deadline=None, max_examples=60)
def test_a_row_is_projected_on_the_factor(n: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    (L, _), c, f = factors(rng, n, 2), rng.standard_normal(n), np.zeros(n)
    kernels.project(L.T.copy(), c, f)
    assert np.allclose(f, L.T @ c, rtol=0, atol=4 * n * EPS * np.abs(L.T) @ np.abs(c))


@pytest.mark.parametrize("lost", [np.nan, np.inf, -np.inf, 1e200])
def test_a_cap_tells_of_an_entry_that_is_lost(lost: float) -> None:
    """1e200 is a number, and its square is none."""
    caps = np.array([9.0, 9.0, 9.0])
    columns, d = np.eye(3), np.ones(3)
    assert not kernels.cap(columns, d, caps)
    columns[0, 2] = lost
    with np.errstate(all="ignore"):
        assert kernels.cap(columns, d, caps)


def test_a_cap_scales_rows_by_the_ratio() -> None:
    columns, d = np.array([[1.0, 0.5, 2.0], [0.0, 1.0, 1.0], [0.0, 0.0, 1.0]]), np.array([1.0, 1.0, 4.0])
    assert kernels.cap(columns, d, np.array([9.0, 9.0, 4.5]))
    assert np.array_equal(columns, [[1.0, 0.5, 1.0], [0.0, 1.0, 0.5], [0.0, 0.0, 1.0]])
    assert np.array_equal(d, [1.0, 1.0, 1.0])


# --- the loops that C has


ARGUMENTS = {  # of a kernel, after L and D: vectors, numbers that are passed alone, and counts
    "triangularise": ("", "", "b"),
    "add": ("w", "", ""),
    "disturb": ("w", "r", ""),
    "correct": ("c", "r", "b"),
    "cap": ("c", "", ""),
    "renew": ("cc", "", ""),
    "project": ("f", "", ""),  # of the row in the place of D
    "decouple": ("w", "", ""),
}
LENGTHS = (2, 5, 6)
AT_ONCE = (1, 2, 4, 8)  # numbers that an instruction takes


@cache
def loops(at_once: int = 1) -> ctypes.CDLL:
    """The kernels for matrices of these sizes, as C."""
    if (compiler := native.compiler()) is None:
        pytest.skip("no C compiler")
    text = "#include <stdbool.h>\n"
    for n in LENGTHS:
        text += f"typedef struct {{ double v[{n}]; }} p{n}_column;\n"
        text += "\n".join(kernels_of(C, f"p{n}", "double", {(name, n) for name in ARGUMENTS}).lines) + "\n"
        for name, (vectors, numbers, counts) in ARGUMENTS.items():
            parameters = [f"double *v{k}" for k, _ in enumerate(vectors)] + ["double r"] * len(numbers)
            parameters += ["double *gain"] * (name == "correct") + ["unsigned b"] * len(counts)
            names = [each.split()[-1].strip("*") for each in parameters]
            call = f"p{n}_{name}((p{n}_column *)L, D{''.join(', ' + each for each in names)})"
            body = f"return {call};" if name in ("cap", "renew") else f"{call}; return 0;"
            text += f"int {name}{n}(double *L, double *D{''.join(', ' + each for each in parameters)}) {{ {body} }}\n"
    folder = Path(tempfile.mkdtemp())
    (folder / "kernels.c").write_text(text)
    command = [compiler, "-std=c99", "-O2", "-ffp-contract=off", "-shared", "-fPIC", "kernels.c", "-o", "kernels.so"]
    command += [f"-DP{n}_VECTOR={at_once}u" for n in LENGTHS]
    subprocess.run(command, cwd=folder, check=True)
    return ctypes.CDLL(str(folder / "kernels.so"))


def pointer(array: np.ndarray) -> ctypes.Array[ctypes.c_double]:
    return array.ctypes.data_as(ctypes.POINTER(ctypes.c_double))  # type: ignore[return-value]


@pytest.mark.parametrize("name", ARGUMENTS)
@given(st.sampled_from(LENGTHS), seeds, st.data())
@settings(deadline=None, max_examples=150)
def test_the_loops_of_c_have_the_bits_of_python(name: str, n: int, seed: int, data: st.DataObject) -> None:
    rng = np.random.default_rng(seed)
    L, d = factors(rng, n, 1)
    band = data.draw(st.integers(1, n))
    Phi = np.tril(rng.standard_normal((n, n)), band) if name == "triangularise" else np.eye(n)
    vectors, numbers, counts = ARGUMENTS[name]
    columns, diagonal = np.ascontiguousarray((Phi @ L).T), d
    others = [10 ** rng.uniform(-1, 1, n) for _ in vectors]
    r, gain = np.array([10 ** rng.uniform(-1, 1)]), np.zeros(n)
    mine = [columns.copy(), diagonal.copy(), *(each.copy() for each in others)]
    theirs = [columns.copy(), diagonal.copy(), *(each.copy() for each in others)]
    last = [np.array(r)] * len(numbers) + [gain.copy()] * (name == "correct") + [band] * len(counts)
    result = kernels.KERNELS[name](*mine, *last) or 0
    ends = [ctypes.c_double(r[0])] * len(numbers) + [pointer(gain)] * (name == "correct")
    ends += [ctypes.c_uint(band)] * len(counts)
    compiled = loops(data.draw(st.sampled_from(AT_ONCE)))
    assert getattr(compiled, f"{name}{n}")(*map(pointer, theirs), *ends) == result
    assert all(np.array_equal(a, b) for a, b in zip(mine, theirs, strict=True))
    assert name != "correct" or np.array_equal(last[1], gain)


@pytest.mark.parametrize("lost", [np.nan, np.inf, -np.inf, -1.0, -1e-9, 1e200])
@pytest.mark.parametrize("n", LENGTHS)
def test_a_cap_leaves_no_entry_of_d_that_is_none(n: int, lost: float) -> None:
    """Python's reading and the loops: what no step makes, and a state that was restored may hold."""
    rng = np.random.default_rng(n)
    for k in range(n):
        (L, d), caps = factors(rng, n, 1), 10 ** rng.uniform(2, 3, n)
        d[k] = lost
        mine, theirs = ((np.ascontiguousarray(L.T), d.copy(), caps.copy()) for _ in range(2))
        with np.errstate(all="ignore"):
            assert kernels.cap(*mine)
        assert getattr(loops(), f"cap{n}")(*map(pointer, theirs)) == 1
        assert all(np.array_equal(a, b, equal_nan=True) for a, b in zip(mine, theirs, strict=True))
        assert (mine[1] >= 0).all()
        assert (mine[1] <= caps).all()


@pytest.mark.parametrize("at_once", AT_ONCE)
def test_what_is_lost_is_restarted_alike_whatever_an_instruction_takes(at_once: int) -> None:
    """A diagonal that is spoiled with it is one again."""
    ends = []
    for compiled in (loops(), loops(at_once)):
        columns, d, w, caps = np.eye(6), np.ones(6), np.full(6, np.inf), np.full(6, 9.0)
        compiled.add6(*map(pointer, (columns, d, w)))
        assert compiled.cap6(*map(pointer, (columns, d, caps))) == 1
        ends += [(np.nan_to_num(columns), d)]
    assert all(np.array_equal(a, b) for a, b in zip(*ends, strict=True))
