"""Emitted Rust: no warning, every bit is that of the C and of Python, and no name or word of a user breaks it."""

import os
import re
import shutil
import subprocess
from collections.abc import Mapping
from pathlib import Path

import emitted
import numpy as np
import pages
import plants
import pytest
from emitted import run, signals, step

import hgogen as hg
from hgogen.call import CallableStep
from hgogen.emit.code import COLUMNS
from hgogen.emit.naming import OneName
from hgogen.emit.syntax import BeyondFloat, Real
from hgogen.emit.syntaxes import KEYWORDS, PRELUDE
from hgogen.model import load
from hgogen.run import native
from hgogen.targets.rust import NoCrate
from tests.sweep import by_turns

NAMES = list(emitted.STEPS)
REALS = ("float", "double")
MODELS = sorted(path for path in plants.MODELS.glob("*.*") if path.is_file())
OWN = [path for path in MODELS if plants.loaded(path).has("step")]
TUNED = [(path.stem, name) for path in MODELS for name in plants.loaded(path).tuning.tables]
LINK = ("-C", "prefer-dynamic", "-C", "rpath")  # to link the standard library as it lies there takes half the time
KINDS = {"float": ("f32", np.float32), "double": ("f64", np.float64)}


def compilers() -> list[str]:
    """Debian's compiler, and another in front of it."""
    paths = (shutil.which("rustc", path="/usr/bin"), os.environ.get("RUSTC"), shutil.which("rustc"))
    return list(dict.fromkeys(path for path in paths if path))


def rustc(which: int = 0) -> str:
    if not shutil.which("cc"):
        pytest.skip("there is no cc, by which rustc links")
    if len(compilers()) <= which:
        pytest.skip("there is no rustc" if which == 0 else "there is no other rustc")
    return compilers()[which]


def built(texts: Mapping[str, str], name: str, folder: Path, *flags: str, compiler: int = 0) -> Path:
    """The crate and the program beside it, compiled with every warning an error."""
    hg.write(texts, folder)
    quick = () if "-O" in flags else ("-C", "codegen-units=1")
    command = [rustc(compiler), "--edition", "2021", "-D", "warnings", *LINK, *quick, *flags]
    run([*command, "--crate-type", "lib", f"{name}.rs"], folder)
    (program,) = (text for text in texts if text != f"{name}.rs")
    run([*command, "--extern", f"{name}=lib{name}.rlib", program, "-o", "program"], folder)
    return folder / "program"


def check(made: hg.Step, real: str, folder: Path, *flags: str, compiler: int = 0) -> str:
    """What the self-check prints."""
    program = built(hg.targets.rust(made, real=real), made.name, folder, *flags, compiler=compiler)
    return subprocess.run([program], capture_output=True, text=True, check=False).stdout


def passed(made: hg.Step) -> str:
    return f"{made.name}: 64 samples as recorded\n"


# --- bits ---------------------------------------------------------------------------------------------------


@pytest.mark.ordinary("integrated-float", "exponential-double", "tunable-float")
@pytest.mark.parametrize(("name", "real"), by_turns(NAMES, REALS))
def test_it_has_no_warning_and_every_bit_is_as_recorded(name: str, real: str, tmp_path: Path) -> None:
    """Not optimised: sums and products of counters that overflow, and indices beyond their array, then panic."""
    assert check(step(name), real, tmp_path) == passed(step(name))


@pytest.mark.slow
@pytest.mark.parametrize("real", REALS)
@pytest.mark.parametrize("name", NAMES)
def test_optimised_it_has_the_same_bits(name: str, real: str, tmp_path: Path) -> None:
    assert check(step(name), real, tmp_path, "-O") == passed(step(name))


@pytest.mark.slow
@pytest.mark.parametrize("real", REALS)
@pytest.mark.parametrize("path", OWN, ids=lambda path: path.stem)
def test_every_model_s_own_step_has_the_bits(path: Path, real: str, tmp_path: Path) -> None:
    made = load(path).step()
    assert check(made, real, tmp_path, "-O") == passed(made)


@pytest.mark.slow
@pytest.mark.parametrize(("model", "name", "real"), [(*pair, REALS[k % 2]) for k, pair in enumerate(TUNED[3::7])])
def test_a_seventh_of_the_tunings_has_the_bits(model: str, name: str, real: str, tmp_path: Path) -> None:
    (path,) = (path for path in MODELS if path.stem == model)
    made = load(path).step(name)
    assert check(made, real, tmp_path, "-O") == passed(made)


@pytest.mark.ordinary("bank")
@pytest.mark.parametrize("name", ["fitzhugh_nagumo", "bank"])
def test_another_compiler_computes_the_same(name: str, tmp_path: Path) -> None:
    assert check(step(name), "float", tmp_path, compiler=1) == passed(step(name))


_MAIN = """
use {name}::{{{structs}Outputs, Parameters, State}};
const GIVEN: [[u64; {width}]; {count}] = [{rows}];
fn main() {{
    let p = Parameters::new();
    let mut s = State::new();
    {spoiled}
    for given in GIVEN.iter() {{
        {input}
        let output = Outputs {{ {outputs} }};
        let status = s.step({arguments}&output);
        let x = s.estimate(&p);
        println!("{{}} {shown}", status, {values});
    }}
}}
"""


def driver(made: CallableStep, u: np.ndarray, y: np.ndarray, spoiled: str = "") -> str:
    """A program that prints the status and the bits of the estimate for each row of a record; `spoiled`: before it."""

    def members(named: tuple[hg.Signal, ...], first: int) -> str:
        return ", ".join(f"{s.name}: f64::from_bits(given[{j}])" for j, s in enumerate(named, first))

    rows = np.hstack([u, y]).view(np.uint64)
    return _MAIN.format(
        name=made.name,
        spoiled=spoiled,
        structs="Inputs, " if made.inputs else "",
        width=rows.shape[1],
        count=len(rows),
        rows=", ".join(f"[{', '.join(map(str, row))}]" for row in rows.tolist()),
        input=f"let input = Inputs {{ {members(made.inputs, 0)} }};" if made.inputs else "",
        outputs=members(made.samples, len(made.inputs)),
        arguments="&p, &input, " if made.inputs else "&p, ",
        shown=" ".join("{}" for _ in made.states),
        values=", ".join(f"x.{s.name}.to_bits()" for s in made.states),
    )


@pytest.mark.ordinary("fitzhugh_nagumo", "no_input")
@pytest.mark.parametrize("name", ["fitzhugh_nagumo", "bank", "many_states", "no_input", "delayed"])
def test_no_number_harms_it_and_python_agrees(name: str, tmp_path: Path) -> None:
    """NaN, infinite, huge and tiny samples among good ones; a sum that overflows would end the program."""
    made, rng = step(name), np.random.default_rng(5)
    values = np.array([np.nan, np.inf, -np.inf, 1e30, -1e30, 1e308, 1e-308])
    u, y = (rng.uniform(-1, 1, (400, len(named))) for named in (made.inputs, made.samples))
    for table in (u, y):
        hit = rng.random(table.shape) < 0.2
        table[hit] = rng.choice(values, hit.sum())
    texts = {f"{made.name}.rs": emitted.crate(name, "double"), "driver.rs": driver(made, u, y)}
    lines = run([str(built(texts, made.name, tmp_path))], tmp_path).splitlines()
    printed = np.array([list(map(int, line.split())) for line in lines], np.uint64)
    made.reset()
    done = made.run(u=u, y=y, engine="python")
    assert (printed[:, 0] == done.status).all()
    assert (printed[:, 1:] == np.ascontiguousarray(done.x).view(np.uint64)).all()


@pytest.mark.ordinary("bank", "window_held")
@pytest.mark.parametrize("name", ["fitzhugh_nagumo", "bank", "window_held", "delayed"])
def test_no_counter_harms_it(name: str, tmp_path: Path) -> None:
    """Whatever the state was restored from, no index is beyond its array, which would end the program."""
    made, rng = step(name), np.random.default_rng(5)
    u, y = (rng.uniform(-1, 1, (100, len(named))) for named in (made.inputs, made.samples))
    counters = [each.text for each in emitted.elements(made) if each.field.kind == "index"]
    assert counters
    for value in ("u32::MAX", "u32::MAX - 1"):
        spoiled = " ".join(f"{text} = {value};" for text in counters)
        texts = {f"{made.name}.rs": emitted.crate(name, "double"), "driver.rs": driver(made, u, y, spoiled)}
        assert run([str(built(texts, made.name, tmp_path))], tmp_path).count("\n") == 100


SEEDED = [
    ("2.4*", "2.5*"),
    ("0.0016666667", "0.00167"),
    ("(reading, 15.0)", "(reading, 1.5)"),
    ("s.L[1] = l31", "s.L[1] = l21"),
    ("|= status::REUSED_U", "|= status::CLAMPED_U"),
]


@pytest.mark.ordinary("s.L[1] = l31-s.L[1] = l21", "|= status::REUSED_U-|= status::CLAMPED_U")
@pytest.mark.parametrize(("right", "wrong"), SEEDED)
def test_the_self_check_catches_what_is_mistyped(right: str, wrong: str, tmp_path: Path) -> None:
    texts = hg.targets.rust(step("fitzhugh_nagumo"))
    source = texts["fitzhugh_nagumo.rs"]
    assert right in source
    changed = {**texts, "fitzhugh_nagumo.rs": source.replace(right, wrong, 1)}
    program = built(changed, "fitzhugh_nagumo", tmp_path, "-A", "unused")
    assert subprocess.run([program], check=False, capture_output=True).returncode == 1


@pytest.mark.full
def test_its_recipe_is_run_by_the_compiler_that_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("RUSTC", rustc())
    assert native.run_recipe(hg.targets.rust(step("pendulum"))) == passed(step("pendulum"))
    monkeypatch.setenv("RUSTC", "no_such_compiler")
    with pytest.raises(native.NoTool, match=r"there is no rustc; install it, or name another by \$RUSTC"):
        native.run_recipe(hg.targets.rust(step("pendulum")))


@pytest.mark.full
@pytest.mark.parametrize("name", ["fitzhugh_nagumo", "bank"])
def test_its_manual_has_no_warning(name: str, tmp_path: Path) -> None:
    """A unit in brackets is no link to an item, what clippy finds better is the order of the C, and nothing public is
    without a word."""
    hg.write(hg.targets.rust(step(name), check=False), tmp_path)
    for tool in ("rustdoc", "clippy-driver"):
        if path := shutil.which(tool):
            lints = ("-D", "warnings", "-D", "missing-docs")
            run([path, "--edition", "2021", "--crate-type", "lib", *lints, f"{name}.rs"], tmp_path)


@pytest.mark.full
def test_the_page_s_lines_compile_and_its_commands_run(tmp_path: Path) -> None:
    page = pages.text("howto/rust")
    (snippet,), (commands,) = pages.blocks("rust", page), (b for b in pages.blocks("sh", page) if "rustc" in b)
    hg.write(hg.targets.rust(load(plants.MODELS / "pendulum.py").step()), tmp_path)
    wrapped = (
        f"use pendulum::*;\nfn main() {{\nlet (tau, y) = (0.1, 0.2);\n{snippet}\nlet _ = (status, x.q, x.w);\n}}\n"
    )
    hg.write({"snippet.rs": wrapped}, tmp_path)
    printed = run(["sh", "-ec", commands.replace("rustc ", f"{rustc()} ")], tmp_path)
    assert printed == "pendulum: 64 samples as recorded\n"
    run(
        [rustc(), "--edition", "2021", "-D", "warnings", "--extern", "pendulum=libpendulum.rlib", "snippet.rs"],
        tmp_path,
    )


# --- text ---------------------------------------------------------------------------------------------------


@pytest.mark.ordinary("fitzhugh_nagumo-double", "pendulum-float", "no_input-double")
@pytest.mark.parametrize("real", REALS)
@pytest.mark.parametrize("name", NAMES)
def test_it_is_plain_and_safe(name: str, real: Real) -> None:
    source, other = emitted.crate(name, real), KINDS[REALS[real == "float"]][0]
    for attribute in ("#![no_std]", "#![forbid(unsafe_code)]"):
        assert f"\n{attribute}\n" in source
    spoken = re.sub(r"//.*", "", source)
    assert not set(re.findall(r"\w+", spoken)) & {"unsafe", "std", "alloc", "static", "unwrap", "extern", other}
    for line in source.splitlines():
        assert line == line.rstrip()
        assert len(line) <= COLUMNS, line


@pytest.mark.ordinary("pendulum", "bent", "chained_in_x")
@pytest.mark.parametrize("name", NAMES)
def test_an_empty_line_stands_between_functions_and_none_at_the_end(name: str) -> None:
    text = emitted.crate(name)
    assert re.search(r"^}\n\n(//.*\n)*fn ", text, re.MULTILINE)
    assert not re.search(r"^}\n(//|fn )", text, re.MULTILINE)
    assert text.endswith("}\n")


@pytest.mark.full
def test_the_same_memory_as_in_c() -> None:
    """The fields of the state, in order, by name and size; the C has the mark of a state before them."""
    for name in NAMES:
        made = step(name)
        rust, c = emitted.crate(name), emitted.files(name)[f"{made.name}.h"]
        (inner,) = re.findall(r"pub struct State \{\n(.*?)\n\}", rust, re.DOTALL)
        (typed,) = re.findall(rf"typedef struct \{{\n((?:(?!typedef).)*)\}} {made.name}_state;", c, re.DOTALL)
        fields = re.findall(r"pub (\w+): (?:\[\w+; (\d+)\]|\w+),", inner)
        typed = re.sub(r"/\*.*?\*/", "", typed, flags=re.DOTALL)
        assert [("ready", ""), *fields] == re.findall(r"(\w+)(?:\[(\d+)\])?;", typed)


def keyworded(system: str, *states: str) -> CallableStep:
    x = [hg.Signal(name, "m", low=-3, high=3) for name in states]
    u, y = hg.Signal("in", low=-1, high=1), hg.Signal("impl", low=-3, high=3)
    flow = [*x[1:], -x[0] + u]
    plant = hg.System(system, states=x, inputs=(u,), outputs=(y,), flow=flow, output=[x[0]])
    return hg.sample(hg.observers.riccati(hg.forms.triangular(plant), Q=[1] * len(x), R=1), dt=0.01)


def test_keywords_get_an_underscore_and_it_is_said(tmp_path: Path) -> None:
    made = keyworded("keywords", "type", "self", "s", "status", "Some", "None")
    files = hg.targets.rust(made)
    names = ("in", "impl", "type", "self", "Some", "None")
    assert dict(files.names) == {name: f"{name}_" for name in names}
    assert files.notes[0].startswith("in Rust in is called in_, ")
    assert "/// type: [m], -3 .. 3" in files["keywords.rs"]
    assert check(made, "float", tmp_path) == passed(made)


@pytest.mark.full
def test_keywords_are_those_of_the_compiler(tmp_path: Path) -> None:
    """No other word that a signal may be called is refused."""
    words = {word for name in NAMES for s in (*step(name).states, *step(name).outputs) for word in (s.name,)}
    words |= {"union", "default", "auto", "raw", "u32", "f64", "usize", "main", "core", "std", "K1", "math", "State"}
    lines = [f"let {word}_: u8 = 0; let _ = {word}_;" for word in sorted(KEYWORDS)]
    lines += [f"let {word}: u8 = 0; let _ = {word};" for word in sorted(words)]
    allowed = "#![allow(non_snake_case)]\n"
    hg.write({"words.rs": f"{allowed}fn main() {{\n" + "\n".join(lines) + "\n}\n"}, tmp_path)
    run([rustc(), "--edition", "2021", "-D", "warnings", "words.rs"], tmp_path)
    for word in sorted(KEYWORDS | PRELUDE):
        hg.write({"word.rs": f"#![allow(unused)]\nfn main() {{ let {word}: u8 = 0; }}\n"}, tmp_path)
        command = [rustc(), "--edition", "2021", "--emit", "metadata", "word.rs"]
        assert subprocess.run(command, cwd=tmp_path, capture_output=True, check=False).returncode, word


@pytest.mark.ordinary("State", "main")
@pytest.mark.parametrize("name", ["f32", "usize", "State", "Parameters", "Some", "status", "main"])
def test_a_model_may_have_the_name_of_a_type(name: str, tmp_path: Path) -> None:
    """The self-check says that it means the crate."""
    assert check(keyworded(name, "a", "b"), "float", tmp_path) == passed(keyworded(name, "a", "b"))


def test_names_that_rust_cannot_carry_are_refused() -> None:
    with pytest.raises(
        OneName,
        match="type is a keyword or a value of the prelude in Rust, where it would be called type_, as another is",
    ):
        hg.targets.rust(keyworded("twice", "type", "type_"))
    for name in ("core", "std", "match"):
        with pytest.raises(NoCrate, match=f"the model {name} cannot be a crate"):
            hg.targets.rust(keyworded(name, "a", "b"))


@pytest.mark.full
def test_words_of_the_user_stay_in_their_comments(tmp_path: Path) -> None:
    a = hg.Signal("a", "*/ int i; /*", "a */ b /* c\nfn d() {\r```", low=-1, high=1)
    y = hg.Signal("y", "V \\", "\\")
    plant = hg.System("words", states=(a,), outputs=(y,), flow=[-a], output=[a])
    made = hg.sample(hg.observers.riccati(hg.forms.triangular(plant), Q=[1], R=1), dt=0.01)
    texts = hg.targets.rust(made, command="hgogen generate models/*.py */ \n#error")
    program = built(texts, "words", tmp_path)
    assert subprocess.run([program], check=False, capture_output=True).returncode == 0


def test_a_number_beyond_float_is_refused_in_float_only() -> None:
    (a,), (y,) = signals("a"), signals("y")
    plant = hg.System("beyond", states=(a,), outputs=(y,), flow=[-a + 1e-60], output=[a])
    made = hg.sample(hg.observers.riccati(hg.forms.triangular(plant), Q=[1], R=1), dt=0.01)
    with pytest.raises(BeyondFloat, match="beyond the range of float"):
        hg.targets.rust(made)
    assert hg.targets.rust(made, real="double")
