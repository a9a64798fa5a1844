"""One sample by either engine: the same bits, whatever comes; quick, without SymPy or CasADi; its own memory."""

import copy
import ctypes
import keyword
import pickle
import re
import statistics
import sys
import threading
import time
import warnings
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
import pytest
import sympy as sp
from hypothesis import given, settings
from hypothesis import strategies as st
from plants import pendulum
from test_call import BUILD, NAN, STEPS, built, needs_compiler, record

import hgogen as hg
from hgogen.call import CallableStep
from hgogen.discretisation.kernels import KERNELS
from hgogen.emit import pygraph
from hgogen.emit.node import CALLS
from hgogen.reading.given import BadNames
from hgogen.run.native import NoCompiler
from hgogen.run.samples import BadShape
from hgogen.step import BadStep

OURS = "D I B V run operands array status fresh shown tune one zero inf nan floor divided source target bytes tolist"
ELEMENTARY = "power_of_two rounds x0"  # of functions that a process defines once, with the first text that calls them
LIBRARIES = tuple(str(Path(module.__file__).parent) for module in (sp, ca))


@cache
def made(name: str, engine: str) -> tuple[CallableStep, bytes]:
    """A step by an engine, and its memory as before the first call."""
    step = copy.copy(built(name))
    object.__setattr__(step, "engine", engine)
    step.reset()
    step.tune()
    return step, bytes(step._kept.whole)


def by(name: str, engine: str) -> CallableStep:
    """A step by an engine, as it was made."""
    step, memory = made(name, engine)
    step.reset()
    step._kept.whole[:] = memory
    return step


def bits(sample: hg.Sample) -> tuple[Any, ...]:
    """All that a sample says, to the bit; NaN equal to NaN."""
    return sample.x.tobytes(), sample.status, sample.flags, np.array(list(sample.traces.values())).tobytes()


# --- the same bits ------------------------------------------------------------------------------------------

hostile = st.one_of(
    st.sampled_from(
        [NAN, np.inf, -np.inf, 1e300, -1e300, 5e-324, -0.0, 0, 3, True, None, np.float32(0.3), np.int8(-2)]
    ),
    st.floats(-3, 3),
    st.floats(width=64),
)


def vectors(size: int) -> st.SearchStrategy[Any]:
    """Samples of a right shape in every guise, and some of a wrong one."""
    rows = st.lists(hostile, min_size=size, max_size=size)
    guises = [rows, rows.map(tuple), rows.map(lambda row: np.array(row, dtype=float))]
    guises += [hostile] if size == 1 else []
    wrong = st.sampled_from([(), (0.1,) * (size + 1), "x", {}, 1j, [[0.1, 0.2], [0.3]], 10**400, np.zeros((2, 2))])
    return st.one_of(*guises, *guises, wrong)


def taken(step: CallableStep, act: tuple[Any, ...]) -> Any:
    """What comes of a call, a refusal as its sentence."""
    kind, *values = act
    try:
        if kind == "sample":
            return bits(step(u=values[0], y=values[1]))
        if kind == "predict":
            return bits(step.predict(u=values[0]))
        if kind == "update":
            return bits(step.update(**{step.outputs[0].name: values[1]}))
        if kind == "adapt":
            return bits(step.adapt())
        if kind == "tune":
            gain = step.layout.gains[0]
            return step.tune(**{gain.name: np.full(gain.size, values[2])})
        if kind == "reset":
            return step.reset()
        if kind == "again":
            return step.restore(step.save())
        run = step.run(**record(step, 5), engine=step.engine)
        return run.x.tobytes(), run.status.tobytes(), run.t.tobytes()
    except (BadShape, BadNames, hg.step.CannotUpdate) as error:
        return str(error)


@pytest.mark.ordinary("high_gain", "held")
@needs_compiler
@pytest.mark.parametrize("name", STEPS)
@given(data=st.data())
@settings(deadline=None, max_examples=15)
def test_both_engines_give_the_same_bits(name: str, data: st.DataObject) -> None:
    """Of samples, sections, records and tunings in any order, absurd ones and refused ones among them."""
    steps = [by(name, engine) for engine in ("c", "python")]
    m, p = len(steps[0].inputs), len(steps[0].outputs)
    kinds = st.sampled_from(["sample"] * 6 + ["predict", "update", "adapt", "tune", "reset", "again", "run"])
    acts = data.draw(st.lists(st.tuples(kinds, vectors(m), vectors(p), st.floats(width=64)), max_size=10))
    for act in acts:
        results = [taken(step, act) for step in steps]
        assert results[0] == results[1], act
        assert steps[0].save() == steps[1].save()


@pytest.mark.ordinary("high_gain", "held")
@needs_compiler
@pytest.mark.parametrize("name", STEPS)
def test_engines_take_turns_on_one_memory(name: str) -> None:
    """Sample, record, sample, by turns: what a record in C alone gives."""
    step, alone = by(name, "python"), by(name, "c")
    samples = record(step, 90)
    whole = alone.run(**samples, engine="c")
    parts = [step.run(**{k: v[:30] for k, v in samples.items()}, engine="c").x]
    parts += [np.array([step(u=u, y=y).x for u, y in zip(samples["u"][30:60], samples["y"][30:60], strict=True)])]
    parts += [step.run(**{k: v[60:] for k, v in samples.items()}, engine="python").x]
    assert np.array_equal(np.concatenate(parts), whole.x)
    assert step.save() == alone.save()


@pytest.mark.parametrize("name", STEPS)
def test_the_text_holds_no_name_of_a_user(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Numbers, our functions and numbered names: so it may be executed."""
    texts = list[str]()
    monkeypatch.setattr(
        pygraph, "defined", lambda text, *rest, defined=pygraph.defined: texts.extend(text) or defined(text, *rest)
    )
    copy.copy(built(name))._kept.entries("python")
    words = {word for line in texts for word in re.findall(r"(?<![\w.])[A-Za-z_]\w*", line)}
    ours = {*OURS.split(), *ELEMENTARY.split()}
    ours |= {*keyword.kwlist, *KERNELS, *CALLS.values(), "float", "int", "range", "dtype"}
    numbered = re.compile(r"(?:section|entry|[tamknr])\d+|w\d+_\d+")
    assert {word for word in words - ours if not numbered.fullmatch(word)} == set()
    assert len(texts) > 20


# --- its cost -----------------------------------------------------------------------------------------------


def cpu(call: Callable[[], Any], times: int) -> float:
    """CPU seconds of a call."""
    begin = time.process_time()
    for _ in range(times):
        call()
    return (time.process_time() - begin) / times


@pytest.mark.parametrize("engine", ["python", pytest.param("c", marks=needs_compiler)])
@pytest.mark.parametrize("name", ["high_gain", "staggered", "two_outputs"])
def test_a_sample_touches_neither_sympy_nor_casadi(name: str, engine: str) -> None:
    """Nor does a record, a section, a tuning, or what a sample says of itself."""
    step, touched = by(name, engine), list[str]()
    u, y = (0.1,) * len(step.inputs), (0.2,) * len(step.outputs)

    def use() -> None:
        str(step(u=u, y=y))
        step.run(u=[u], y=[y])
        if step.code.separable:
            step.predict(u=u)
            step.update(**{step.outputs[0].name: 0.1})
            step.adapt()
        step.tune(**{step.layout.gains[0].name: np.ones(step.layout.gains[0].size)})
        step.reset()

    def watch(frame: Any, event: str, argument: Any) -> None:
        file = frame.f_code.co_filename if event == "call" else ""
        module = str(getattr(argument, "__module__", "")) if event == "c_call" else ""
        if file.startswith(LIBRARIES) or module.startswith(("casadi", "_casadi", "sympy")):
            touched.append(f"{file} {module}")

    use()
    sys.setprofile(watch)
    try:
        use()
    finally:
        sys.setprofile(None)
    assert touched == []


@needs_compiler
@pytest.mark.parametrize("name", ["high_gain", "staggered"])
def test_a_sample_costs_at_most_four_bare_calls(name: str) -> None:
    """Of NAME_step by ctypes with kept pointers. Medians of batches that take turns, in CPU time."""
    step = by(name, "c")
    step(u=0.1, y=0.2)
    plain = getattr(step._kept._library, f"{step.name}_step")
    structs = (step._kept.record[kind] for kind in ("state", "params", "input", "output"))
    s, p, one, two = (ctypes.c_void_p(array.ctypes.data) for array in structs)

    def bare() -> int:
        return plain(s, p, one, two)

    def sample() -> hg.Sample:
        return step(u=0.1, y=0.2)

    batches = [(cpu(sample, 300), cpu(bare, 300)) for _ in range(31)]
    mine, least = (statistics.median(column) for column in zip(*batches, strict=True))
    assert mine < 4 * least


def test_a_sample_without_a_compiler_costs_little() -> None:
    """60 us of CPU for the README's pendulum; the median of batches, because other work on the core slows some down."""
    step = by("high_gain", "python")
    step(u=0.1, y=0.2)
    assert statistics.median(cpu(lambda: step(u=0.1, y=0.2), 50) for _ in range(15)) < 60e-6


# --- a value, and a memory of its own -----------------------------------------------------------------------


def test_each_sample_is_a_value_of_its_own() -> None:
    step = by("staggered", "python")
    first, before = step(u=0.1, y=0.5), None
    before = bits(first)
    step(u=0.9, y=-0.5)
    assert bits(first) == before
    assert first["x1"] == first.x[0]
    assert first.x is first.x
    again = pickle.loads(pickle.dumps(first))
    assert bits(again) == before
    assert again.names == first.names
    with pytest.raises(AttributeError):
        first.status = 3  # type: ignore[misc]


@pytest.mark.parametrize(
    "copied",
    [copy.copy, copy.deepcopy, lambda step: pickle.loads(pickle.dumps(step))],
    ids=["copy", "deep", "pickle"],
)
def test_a_copy_goes_on_by_itself(copied: Callable[[CallableStep], CallableStep]) -> None:
    """From the state and the gains of the first one."""
    step = BUILD["held"]()
    step.tune(R=10.0)
    for k in range(5):
        step(u=0.1, y=0.1 * k)
    before = step.save()
    other = copied(step)
    assert other.save() == before
    one, two = step(u=0.3, y=0.4), other(u=0.3, y=0.4)
    assert bits(one) == bits(two)
    other(u=0.3, y=-0.4)
    other.tune(R=0.1)
    assert step.save() != other.save()
    assert bits(step(u=0.1, y=0.1)) != bits(other(u=0.1, y=0.1))
    assert step.run(u=[0.0], y=[0.0], engine="python").t[0] == pytest.approx(7 * 0.01)


def test_steps_of_one_model_do_not_share() -> None:
    one, two = BUILD["held"](), BUILD["held"]()
    fresh = two.save()
    for _ in range(3):
        one(u=0.5, y=0.7)
    assert two.save() == fresh
    assert one.save() != fresh


@needs_compiler
def test_threads_do_not_crash_a_step() -> None:
    """A step is for one thread; from several, the order of samples is open, and every estimate finite."""
    step, seen = by("staggered", "c"), list[np.ndarray]()

    def work() -> None:
        seen.extend(step(u=0.1, y=0.2).x for _ in range(300))

    threads = [threading.Thread(target=work) for _ in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert len(seen) == 1200
    assert np.isfinite(seen).all()


# --- the engine ---------------------------------------------------------------------------------------------


def test_an_unknown_engine_is_refused() -> None:
    with pytest.raises(BadStep, match=r"engine = 'fortran' must be \"c\", \"python\" or None"):
        hg.sample(pendulum(), hg.methods.rk4, dt=0.01, engine="fortran")  # type: ignore[arg-type]


def test_without_a_compiler_a_sample_says_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    """It is quick enough; asked for C by name it is refused, and nothing is taken."""
    monkeypatch.setenv("PATH", "")
    monkeypatch.delenv("CC", raising=False)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        BUILD["high_gain"]()(u=0.1, y=0.2)
    step = hg.sample(pendulum(), hg.methods.rk4, dt=0.01, engine="c")
    before = step.save()
    with pytest.raises(NoCompiler, match="engine='python'"):
        step(u=0.1, y=0.2)
    assert step.save() == before


def test_a_bad_gain_leaves_the_others_as_they_are() -> None:
    """The whole of a tuning is read before any of it is set."""
    step = by("held", "python")
    step(u=0.1, y=0.2)
    before = bytes(step._kept.whole)
    with pytest.raises(BadShape, match="names nothing tunable"):
        step.tune(R=3.0, gamma=1.0)
    assert bytes(step._kept.whole) == before


@pytest.mark.parametrize("value", [10**400, [10**400]])
def test_a_number_beyond_a_double_is_a_sentence(value: Any) -> None:
    with pytest.raises(BadShape, match=r"^y has a number beyond the range of a double$"):
        by("held", "python")(u=0.1, y=value)
