"""A saved state is restored into the program that saved it, and refused where anything of it is another: in C, Rust and
Python."""

import struct
import zlib
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from string import Template
from typing import Any

import emitted
import numpy as np
import pytest
from emitted import compiled, run, step, tool
from hypothesis import given, settings
from hypothesis import strategies as st

import hgogen as hg
from hgogen.emit import pystep
from hgogen.emit.naming import prefixed
from hgogen.emit.saved import ADDED, NotSaved, layout, sealed
from hgogen.program import Field, Group
from hgogen.run import native

SANITIZE = ("-O1", "-g1", "-fsanitize=address,undefined", "-fno-sanitize-recover=all")
needs_compiler = pytest.mark.skipif(native.compiler() is None, reason="there is no C compiler")
VARIANTS: dict[str, Callable[[Any], hg.Step]] = {
    "precision": lambda made: made.rebuilt(real="float"),
    "dt": lambda made: made.rebuilt(dt=2e-3),
    "preference": lambda made: made.rebuilt(prefer="flash"),
    "guards": lambda made: made.rebuilt(guards="none"),
    "method": lambda made: made.rebuilt(method=hg.methods.heun),
    "gain": lambda made: hg.sample(hg.observers.riccati(made.observer.form, Q=[1, 1], R=2), made.method, made.dt),
    "model": lambda made: hg.sample(hg.observers.riccati(hg.forms.triangular(twice()), Q=[1, 1], R=1), dt=made.dt),
}


def plant(factor: float = 1) -> hg.System:
    """Two states in a chain."""
    a, b, y = emitted.signals("a b y", -2, 2)
    return hg.System("kept", states=(a, b), outputs=(y,), flow=[b, -factor * a - b], output=[a])


def twice() -> hg.System:
    return plant(2)


def built() -> Any:
    """A filter by a method that integrates, in double."""
    return hg.sample(hg.observers.riccati(hg.forms.triangular(plant()), Q=[1, 1], R=1), hg.methods.rk4, dt=1e-3)


# --- Python -------------------------------------------------------------------------------------------------


@pytest.mark.ordinary("guards", "gain")
@pytest.mark.parametrize("what", VARIANTS)
def test_a_state_of_another_program_is_refused_and_the_state_stays(what: str) -> None:
    """Of the same size, too: the checksum is right, and the digest differs."""
    made = built()
    other: Any = VARIANTS[what](made)
    made(y=0.5)
    other(y=0.25)
    before = other.save()
    strangers = [made.save()]
    if len(made.save()) == len(before):
        mine, body = made.save(), layout(made, made.real) + before[8:-4]
        strangers += [mine[:8] + before[8:], body + struct.pack("<I", zlib.crc32(body))]
    for stranger in strangers:
        with pytest.raises(NotSaved, match=r"is not of this step|of another model, observer|is damaged"):
            other.restore(stranger)
        assert other.save() == before


@given(st.data())
@settings(max_examples=60, deadline=None)
def test_no_bit_of_it_may_be_another(data: Any) -> None:
    made = built()
    made(y=0.5)
    saved = made.save()
    bits = data.draw(st.sets(st.integers(0, 8 * len(saved) - 1), min_size=1, max_size=3))
    spoiled = bytearray(saved)
    for bit in bits:
        spoiled[bit // 8] ^= 1 << bit % 8
    length = data.draw(st.integers(0, len(saved) - 1))
    for wrong in (bytes(spoiled), saved[:length], saved + saved[:length] if length else b""):
        with pytest.raises(NotSaved):
            made.restore(wrong)
        assert made.save() == saved


def test_a_name_and_a_first_estimate_are_no_other_program() -> None:
    made = built()
    made(y=0.5)
    for other in (prefixed(made, "other"), made.started({"a": 1}), made.rebuilt()):
        other.restore(made.save())
        assert other.save() == made.save()


def test_a_state_without_its_mark_is_refused() -> None:
    made = built()
    with pytest.raises(NotSaved, match="of another model"):
        made.restore(sealed(made, made.real, bytes(len(made.save()) - ADDED)))


def test_states_of_many_records_are_saved_ones() -> None:
    made = built()
    many = made.run_many(y=np.ones((3, 4, 1)))
    for state in many.states:
        made.restore(state)
        assert made.save() == state
    spoiled = many.states[0][:-1] + b"\0"
    with pytest.raises(NotSaved, match="damaged"):
        made.run_many(y=np.ones((1, 4, 1)), starts=[spoiled if spoiled != many.states[0] else many.states[0][1:]])


def declared(**changed: Any) -> hg.System:
    """A plant with a constant parameter and a table, or with another value, range or table."""
    values: dict[str, Any] = {"k": 1.0, "range": (-2.0, 2.0), "ys": (0.0, 1.0, 3.0)} | changed
    x1 = hg.Signal("x1", low=values["range"][0], high=values["range"][1])
    x2, y = hg.Signal("x2", low=-2, high=2), hg.Signal("y", low=-2, high=2)
    k, curve = hg.Signal("k", nominal=values["k"]), hg.table(x1, xs=[-2, 0, 2], ys=values["ys"], name="curve")
    flow = [x2, -k * x1 - curve]
    return hg.System("kept", states=(x1, x2), outputs=(y,), parameters=(k,), flow=flow, output=[x1])


def injected(system: hg.System, **arguments: Any) -> hg.Step:
    chosen = {"theta": 3, "alpha": 3, "beta": 1, "poles": (-1, -1)} | arguments
    observer = hg.observers.filtered(hg.forms.triangular(system), **chosen)
    return hg.sample(observer, dt=1e-3)


def selected(period: float, covariance: tuple[float, float] = (1, 1)) -> hg.Step:
    form, theta = hg.forms.triangular(declared()), hg.theta.decaying(3, 1)
    member = hg.observers.riccati(form, Q=[1, 1], R=1, theta=theta, covariance=covariance)
    return hg.sample(hg.observers.bank(member, count=2, period=period), dt=1e-2)


CONSTANTS: dict[str, Callable[[], tuple[hg.Step, hg.Step]]] = {
    "value": lambda: (injected(declared()), injected(declared(k=1.5))),
    "range": lambda: (injected(declared()), injected(declared(range=(-2.0, 1.5)))),
    "table": lambda: (injected(declared()), injected(declared(ys=(0.0, 1.0, 3.5)))),
    "poles": lambda: (injected(declared()), injected(declared(), poles=(-1, -2))),
    "filter": lambda: (injected(declared()), injected(declared(), alpha=2.5)),
    "period": lambda: (selected(1.0), selected(2.0)),
    "covariance of a member": lambda: (selected(1.0), selected(1.0, (2, 1))),
}


@pytest.mark.ordinary("poles", "filter")
@pytest.mark.parametrize("what", CONSTANTS)
def test_the_digest_is_of_constants_that_no_field_holds(what: str) -> None:
    """The same fields of the same size: what the code computes with is folded into it."""
    one, other = CONSTANTS[what]()
    assert len(layout(one, "float")) == len(layout(other, "float")) == 8
    assert layout(one, "float") != layout(other, "float")


def test_arguments_that_are_equal_have_one_digest() -> None:
    one = injected(declared(), poles=(-1, -2), theta=3)
    assert layout(one, "float") == layout(injected(declared(), poles=[-1.0, -2.0], theta=3.0), "float")
    assert layout(one, "float") == layout(injected(declared(), poles=np.array([-1.0, -2.0]), initial=[1, 1]), "float")


def test_the_digest_is_of_names_of_elements_and_of_what_lies_in_groups() -> None:
    made = built()

    def digest(field: Field) -> bytes:
        groups = (Group("outer", 3, (), groups=(Group("inner", 2, (field,)),)),)
        grouped = replace(made.layout, groups=groups)
        return layout(hg.Step(made.name, made.observer, made.method, made.clock, grouped, made.code), "double")

    field = Field("at", (0.0, 0.0), labels=("a", "b"))
    others = [replace(field, labels=("b", "a")), replace(field, initial=(0.0,) * 3), replace(field, name="on")]
    assert len({digest(each) for each in (field, *others)}) == 4


# --- C ------------------------------------------------------------------------------------------------------

_C = Template("""
#include <stdio.h>
#include <string.h>

#include "kept.h"

static const kept_params constant = KEPT_PARAMS_INIT;
static kept_state s; /* with zeros between its members, as Python has them */

/* saves to a file what three samples leave, or restores a file and takes one more; with constant parameters */
int main(int argc, char **argv)
{
    kept_params p;
    kept_plant x;
    kept_output measurement = {($real)0.5};
    unsigned char saved[1024];
    kept_init(&s, &p);
    for (unsigned k = 0u; k < 3u; ++k) {
        (void)kept_step(&s, (k == 1u) ? &p : &constant, &measurement);
    }
    FILE *const file = fopen(argv[2], (argv[1][0] == 's') ? "wb" : "rb");
    if ((argc != 3) || (file == NULL)) {
        return 2;
    }
    if (argv[1][0] == 's') {
        kept_save(&s, saved);
        return (fwrite(saved, 1u, KEPT_SAVED, file) == KEPT_SAVED) ? fclose(file) : 3;
    }
    const size_t size = fread(saved, 1u, sizeof saved, file);
    (void)fclose(file);
    kept_state before;
    (void)memcpy(&before, &s, sizeof s);
    unsigned refused = kept_restore(&s, saved, size);
    if ((refused != 0u) && (memcmp(&before, &s, sizeof s) != 0)) {
        return 4;
    }
    /* every bit, and every length */
    for (size_t bit = 0u; (bit < 8u*size) && (refused == 0u); ++bit) {
        saved[bit/8u] = (unsigned char)(saved[bit/8u] ^ (1u << (bit%8u)));
        if (kept_restore(&before, saved, size) != 1u) {
            return 5;
        }
        saved[bit/8u] = (unsigned char)(saved[bit/8u] ^ (1u << (bit%8u)));
    }
    for (size_t length = 0u; (length < size) && (refused == 0u); ++length) {
        if (kept_restore(&before, saved, length) != 1u) {
            return 6;
        }
    }
    (void)kept_step(&s, &constant, &measurement);
    kept_estimate(&s, &constant, &x);
    (void)printf("%u %.17g %.17g\\n", refused, (double)x.a, (double)x.b);
    return 0;
}
""")


def program(made: Any, folder: Path, compiler: str = "gcc") -> Path:
    """An executable that saves and restores."""
    folder.mkdir()
    texts = dict(hg.targets.c99(made, real=made.real, check=False))
    return compiled(tool(compiler), {**texts, "main.c": _C.substitute(real=made.real)}, folder, *SANITIZE)


@pytest.mark.ordinary("gcc")
@pytest.mark.parametrize("compiler", ["gcc", "clang"])
def test_what_c_saves_it_restores_as_python_does(compiler: str, tmp_path: Path) -> None:
    """The same bytes; every bit and every length of it decides, and constant parameters have the bits of init's."""
    made = built()
    own = program(made, tmp_path / "own", compiler)
    run([str(own), "s", "saved"], tmp_path)
    for _ in range(3):
        made(y=0.5)
    assert (tmp_path / "saved").read_bytes() == made.save()
    after = made(y=0.5)
    refused, *x = run([str(own), "r", "saved"], tmp_path).split()
    assert (refused, [float(each) for each in x]) == ("0", after.x.tolist())


@pytest.mark.full
def test_what_c_saves_no_other_program_restores(tmp_path: Path) -> None:
    made = built()
    run([str(program(made, tmp_path / "own")), "s", "saved"], tmp_path)
    for name, vary in VARIANTS.items():
        other: Any = vary(made)
        for _ in range(4):
            after = other(y=0.5)
        refused, *x = run([str(program(other, tmp_path / name)), "r", "saved"], tmp_path).split()
        assert (name, refused, [float(each) for each in x]) == (name, "1", after.x.tolist())


@pytest.mark.ordinary(
    "float-tunable", "double-tunable", "double-bank", "double-delayed", "double-two", "double-one_state"
)
@needs_compiler
@pytest.mark.parametrize("name", ["tunable", "bank", "delayed", "two", "one_state"])
@pytest.mark.parametrize("real", ["float", "double"])
def test_constant_parameters_are_those_of_init(name: str, real: str) -> None:
    made = step(name).rebuilt(real=real)
    made._kept.entries("c")
    assert made._kept.record["params"].tobytes() == pystep.tuned(made, real).tobytes()


# --- Rust ---------------------------------------------------------------------------------------------------

_RUST = Template("""
use ::$name::{LAYOUT, SAVED, ${inputs}Outputs, Parameters, State};

fn main() {
    let p = Parameters::new();
    let mut s = State::new();
    let output = Outputs { $outputs };
    $input
    for _ in 0..5 {
        s.step($arguments);
    }
    let saved = s.save();
    assert!(saved.len() == SAVED && saved[..8] == LAYOUT);
    assert!(State::restored(&saved) == Some(s));
    assert!(State::new() != s);
    for bit in 0..8 * SAVED {
        let mut spoiled = saved;
        spoiled[bit / 8] ^= 1 << (bit % 8);
        assert!(State::restored(&spoiled).is_none());
    }
    for length in 0..SAVED {
        assert!(State::restored(&saved[..length]).is_none());
    }
    print!("saved");
}
""")


@pytest.mark.ordinary("two-float", "bank-double")
@pytest.mark.parametrize(("name", "real"), [("two", "float"), ("bank", "double"), ("delayed", "float")])
def test_rust_restores_what_it_saves_and_nothing_else(name: str, real: str, tmp_path: Path) -> None:
    made = step(name)
    outputs = ", ".join(f"{y.name}: 0.0" if y in made.ages else f"{y.name}: 0.25" for y in made.samples)
    inputs = ", ".join(f"{u.name}: 0.5" for u in made.inputs)
    texts = {f"{made.name}.rs": hg.targets.rust(made, real=real, check=False)[f"{made.name}.rs"]}
    texts["main.rs"] = _RUST.substitute(
        name=made.name,
        inputs="Inputs, " if made.inputs else "",
        outputs=outputs,
        input=f"let input = Inputs {{ {inputs} }};" if made.inputs else "",
        arguments="&p, &input, &output" if made.inputs else "&p, &output",
    )
    for file, text in texts.items():
        (tmp_path / file).write_text(text)
    rustc = [tool("rustc"), "--edition", "2021", "-O"]
    run([*rustc, "--crate-type", "lib", f"{made.name}.rs"], tmp_path)
    run([*rustc, "--extern", f"{made.name}=lib{made.name}.rlib", "main.rs", "-o", "main"], tmp_path)
    assert run([str(tmp_path / "main")], tmp_path) == "saved"


def test_digests_of_languages_precisions_and_steps_differ() -> None:
    made = built()
    every = [layout(made, real, language) for real in ("float", "double") for language in ("c", "rust")]
    every += [layout(vary(made), "double") for name, vary in VARIANTS.items() if name != "precision"]
    assert len(set(every)) == len(every)
