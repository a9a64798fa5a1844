"""One word means one thing in emitted code: what a sensor reads is a reading, and how far it is off an error."""

import re

import emitted
import pytest

each = pytest.mark.parametrize("name", emitted.STEPS)


def code(text: str, comment: str) -> str:
    """Without comments."""
    return re.sub(comment, "", text, flags=re.DOTALL)


def source(name: str) -> str:
    return code(emitted.files(name)[f"{emitted.step(name).name}.c"], r"/\*.*?\*/")


@pytest.mark.ordinary("pendulum", "one_state", "chained_in_x")
@each
def test_what_a_sensor_reads_is_called_so(name: str) -> None:
    """By the output as well, where a function reads several; a section of an update reads one."""
    step = emitted.step(name)
    outputs = {output.name for output in step.outputs}
    named = [
        (local, output)
        for local, output in re.findall(r"(\w+) = measurement->(\w+);", source(name))
        if output in outputs
    ]
    assert named or step.ages
    wanted = (
        {"reading", "readings"} if len(outputs) == 1 else {"reading", "readings", *(f"reading_{y}" for y in outputs)}
    )
    assert {local for local, _ in named} <= {*wanted, *["y_given"] * bool(step.ages)}  # what a period is given


@pytest.mark.ordinary("fitzhugh_nagumo", "pendulum", "cascaded_tanks", "two", "bank")
@each
def test_neither_sample_nor_innovation_is_a_number_of_a_section(name: str) -> None:
    """A sample is what comes; an innovation is what theta adapts by."""
    text = source(name)
    assert not re.search(r"\b(?:float|unsigned|bool) (?:sample|\w*y_given)\b", text)
    assert not re.search(r"\bfloat innovation = 0", text)


@pytest.mark.ordinary("pendulum", "bent", "chained_in_x")
@each
def test_rust_has_the_same_words(name: str) -> None:
    text, c = code(emitted.crate(name), r"//[^\n]*"), source(name)
    words = {r"\breading\b": "reading", r"\boutput_error\b": "output_error", r"\bsample\b": "sample"}
    assert {word for pattern, word in words.items() if re.search(pattern, text)} == {
        word for pattern, word in words.items() if re.search(pattern, c)
    }


def test_an_age_is_no_measurement() -> None:
    text = source("delayed")
    assert "const float y_age = measurement->y_age;" in text
    assert "reading_y_age" not in text
