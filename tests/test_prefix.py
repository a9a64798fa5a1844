"""The name that emitted code begins with: two observers of one plant in one program, and names that are refused."""

import shutil
from functools import cache
from pathlib import Path

import emitted
import pytest
from emitted import run, step, tool

import hgogen as hg
from hgogen.emit.naming import BadPrefix, HidesHeader, prefixed
from hgogen.reading.files import BadFileName
from hgogen.run.native import WARNINGS
from hgogen.signal import BadName
from hgogen.targets.rust import NoCrate

MAIN = """
#include "left.h"
#include "right.h"
unsigned left_check(void);
unsigned right_check(void);
int main(void)
{
    left_state s;
    left_params p;
    right_state t;
    right_params q;
    left_init(&s, &p);
    right_init(&t, &q);
    if (p.gain.theta >= q.gain.theta) {
        return 3;
    }
    return (int)(left_check() + right_check());
}
"""


@cache
def of_the_pendulum(name: str, theta: float) -> hg.Step:
    form = hg.forms.triangular(step("pendulum").observer.form.system)
    return prefixed(hg.sample(hg.observers.high_gain(form, theta=theta, poles=(-1, -1)), dt=1e-3), name)


@pytest.mark.full
def test_two_observers_of_one_plant_link_together(tmp_path: Path) -> None:
    """And each is its own: both self-checks, every bit, with every warning an error."""
    both = of_the_pendulum("left", 10), of_the_pendulum("right", 20)
    texts = {file: text for one in both for file, text in hg.targets.c99(one).items()}
    assert len(texts) == 8
    hg.write({**texts, "main.c": MAIN}, tmp_path)
    exact = ("-DLEFT_EXACT", "-DRIGHT_EXACT")
    sources = [file for file in texts if file.endswith(".c")]
    run([tool("gcc"), "-std=c99", "-O2", *WARNINGS, *exact, *sources, "main.c", "-o", "program"], tmp_path)
    run([str(tmp_path / "program")], tmp_path)


@pytest.mark.full
def test_two_crates_are_in_one_program(tmp_path: Path) -> None:
    rustc = shutil.which("rustc", path="/usr/bin") or tool("rustc")
    for name, theta in (("left", 10), ("right", 20)):
        hg.write(hg.targets.rust(of_the_pendulum(name, theta), check=False), tmp_path)
        run([rustc, "--edition", "2021", "--crate-type", "lib", f"{name}.rs"], tmp_path)
    lines = (
        "let (l, r) = (left::Parameters::new(), right::Parameters::new());",
        "assert!(l.gain.theta < r.gain.theta);",
    )
    (tmp_path / "main.rs").write_text(f"fn main() {{ {' '.join(lines)} }}\n")
    linked = [word for name in ("left", "right") for word in ("--extern", f"{name}=lib{name}.rlib")]
    run([rustc, "--edition", "2021", *linked, "main.rs"], tmp_path)
    run([str(tmp_path / "main")], tmp_path)


@pytest.mark.ordinary("fitzhugh_nagumo-rust", "bank-rust", "tables-c99", "tables-rust", "delayed-rust")
@pytest.mark.parametrize("target", ["c99", "rust"])
@pytest.mark.parametrize("name", ["fitzhugh_nagumo", "bank", "tables", "delayed"])
def test_nothing_else_is_another(name: str, target: str) -> None:
    """A name of the same length, so that lines are broken alike."""
    made = step(name)
    other = made.name[:-1] + "qQ"[made.name.endswith("q")]
    emit = getattr(hg.targets, target)
    as_other = emit(prefixed(made, other))
    for (file, text), (renamed, again) in zip(emit(made).items(), as_other.items(), strict=True):
        assert renamed == file.replace(made.name, other)
        assert again != text
        again, text = again.replace("\\_", "_"), text.replace("\\_", "_")  # as Markdown writes names
        assert again.replace(other, made.name).replace(other.upper(), made.name.upper()) == text


def test_a_step_with_another_name_still_runs() -> None:
    first, *others = (prefixed(emitted.step("pendulum"), name)(u=0.1, y=0.02) for name in ("pendulum", "left"))
    assert [(each.x.tolist(), each.status) for each in others] == [(first.x.tolist(), first.status)]


@pytest.mark.parametrize(
    ("name", "error", "said"),
    [
        ("2fast", BadName, "is not an identifier"),
        ("", BadName, "is not an identifier"),
        ("a-b", BadName, "'a-b' is not an identifier .* such as 'a_b'"),
        ("../out", BadName, "is not an identifier"),
        ("wärme", BadName, "is not an identifier"),
        ("_left", BadName, "is not an identifier"),
        ("left__", BadName, "double underscore"),
        ("con", BadFileName, "device on Windows"),
        ("x" * 101, BadFileName, "longer than 100 bytes"),
        ("while", BadPrefix, "the name while is a keyword or a macro of C; take another, such as while_observer"),
        ("class", BadPrefix, "class is a keyword"),
        ("NAN", BadPrefix, "NAN is a keyword or a macro"),
        ("math", HidesHeader, "would be math.h, which hides <math.h>"),
    ],
)
def test_a_name_that_c_cannot_carry_is_refused(name: str, error: type[Exception], said: str) -> None:
    with pytest.raises(error, match=said):
        prefixed(step("pendulum"), name)


def test_a_name_that_rust_cannot_carry_is_refused() -> None:
    with pytest.raises(NoCrate, match="impl cannot be a crate"):
        hg.targets.rust(prefixed(step("pendulum"), "impl"))
