"""Names in C: a keyword, a macro of a standard header or of a compiler never takes the place of a signal's."""

import re
import subprocess
from pathlib import Path

import pytest
from emitted import tool

import hgogen as hg
from hgogen.emit.naming import HidesHeader, OneName, c_name, renamed
from hgogen.emit.syntaxes import C
from hgogen.run.native import WARNINGS

C_HEADERS = """
    assert complex ctype errno fenv float inttypes iso646 limits locale math setjmp signal stdalign stdarg stdatomic
    stdbool stddef stdint stdio stdlib stdnoreturn string tgmath time wchar wctype
"""
AVR_HEADERS = (
    "assert ctype errno float inttypes limits math setjmp stdbool stddef stdint stdio stdlib string time avr/io"
)
CPP_HEADERS = (
    "cassert ccomplex cctype cerrno cfenv cfloat cinttypes climits clocale cmath csetjmp csignal cstdarg cstddef"
)
CPP_HEADERS += " cstdint cstdio cstdlib cstring ctime cwchar cwctype complex vector string algorithm"

COMPILERS = {
    "gcc": (C_HEADERS, ["-std=gnu11"]),
    "g++": (CPP_HEADERS, ["-std=gnu++17", "-x", "c++"]),
    "arm-none-eabi-gcc": (C_HEADERS, ["-std=gnu11", "-mcpu=cortex-m4"]),
    "avr-gcc": (AVR_HEADERS, ["-std=gnu11", "-mmcu=atmega328p"]),
}

# 200 names that somebody may give: keywords, macros, types and functions of the library, registers, and plain ones
NAMES = """
    I linux unix i386 M_PI M_E NAN INFINITY HUGE_VAL NULL EOF SREG SP SPL PORTB PINB DDRB TCNT1 OCR1A UDR0 ADC ADCL ADCH
    stdin stdout stderr errno signgam BUFSIZ RAND_MAX CHAR_BIT INT_MAX DBL_MAX FLT_EPSILON SIGINT SIG_DFL EDOM ERANGE
    PI TWO_PI DEG_TO_RAD HIGH LOW INPUT OUTPUT DEFAULT B0 B1 A0 SS SCL SDA GPIOA TIM1 ADC1 CAN1 RCC RTC SET RESET
    near far small interface IN OUT TRUE FALSE ERROR DEBUG NDEBUG
    int float double long short char unsigned signed void const volatile static register auto extern inline restrict
    struct union enum typedef sizeof return if else for while do switch case default break continue goto bool complex
    class new delete this public private protected virtual template typename operator namespace using friend throw try
    catch explicit mutable export and or not xor bitand compl true false nullptr constexpr noexcept decltype alignas
    static_assert thread_local typeof asm concept requires co_await
    size_t int32_t uint8_t time_t div_t FILE va_list sin cos exp log sqrt pow fabs abs gamma y0 y1 j0 j1 jn yn
    time clock signal raise abort exit free malloc printf puts remove rename index main assert isnan isinf min max floor
    round real imag conj norm arg std string vector state input output plant gain derived status none s p x in out i k u
    k2 i2 z e t t1 step init tune reset estimate predict update theta R Q P D L S V T omega phi alpha beta x1 I2 L21
"""


def plant(state: str, input: str, output: str, parameter: str, name: str) -> hg.System:
    """x' = -p x + u, y = x."""
    x, u, y = (hg.Signal(each, low=-1, high=1) for each in (state, input, output))
    p = hg.Signal(parameter, nominal=1, low=0.5, high=2)
    return hg.System(name, states=(x,), inputs=(u,), outputs=(y,), parameters=(p,), flow=[-p * x + u], output=[x])


def sampled(system: hg.System) -> hg.Step:
    observer = hg.observers.high_gain(hg.forms.triangular(system), theta=2, poles=(-1,))
    return hg.sample(observer, hg.methods.euler, dt=0.01)


@pytest.mark.parametrize("compiler", COMPILERS)
def test_every_macro_of_the_standard_headers_is_known(compiler: str) -> None:
    headers, flags = COMPILERS[compiler]
    lines = "".join(f"#include <{name}{'' if compiler == 'g++' else '.h'}>\n" for name in headers.split())
    command = [tool(compiler), *(["-x", "c"] if compiler != "g++" else []), *flags, "-dM", "-E", "-"]
    text = subprocess.run(command, input=lines, capture_output=True, text=True, check=True).stdout
    macros = set(re.findall(r"^#define ([A-Za-z]\w*) ", text, re.M))
    assert len(macros) > 100
    assert not {name for name in macros if "__" not in name and c_name(name) == name}


def test_a_renamed_signal_is_said_in_the_header_and_keeps_its_own_name_in_python() -> None:
    step = sampled(plant("I", "u", "SREG", "p", "motor"))
    header = hg.targets.c99(step, check=False)["motor.h"]
    assert renamed(step, C) == {"I": "I_", "SREG": "SREG_"}
    text = " ".join(header.replace(" * ", " ").split())
    assert "In C SREG is called SREG_, I is called I_, for a keyword or a macro has the name" in text
    assert "float I_; /**< I: -1 .. 1 */" in text
    assert "float u; /**< -1 .. 1 */" in text
    assert (
        "float far_; /**< far: 0.5 .. 2 */" in hg.targets.c99(sampled(plant("a", "u", "y", "far", "motor")))["motor.h"]
    )
    assert step(u=0, y=0.5)["I"] == pytest.approx(0.0)
    assert not renamed(sampled(plant("a", "u", "y", "p", "motor")), C)


def test_two_names_that_c_would_call_the_same_are_refused() -> None:
    a, b = hg.Signal("I", low=-1, high=1), hg.Signal("I_", low=-1, high=1)
    y = hg.Signal("y", low=-1, high=1)
    system = hg.System("motor", states=(a, b), outputs=(y,), flow=[b, -a], output=[a])
    step = hg.sample(
        hg.observers.high_gain(hg.forms.triangular(system), theta=2, poles=(-1, -1)), dt=0.01, method=hg.methods.rk4
    )
    with pytest.raises(OneName, match="I is a keyword or a macro in C, where it would be called I_, as another is"):
        hg.targets.c99(step)


@pytest.mark.parametrize("name", ["math", "stdio", "Float", "arm_math"])
def test_a_model_does_not_hide_a_standard_header(name: str) -> None:
    with pytest.raises(HidesHeader, match=f"{name}.h, which hides <{name.lower()}.h>; rename the model"):
        hg.targets.c99(sampled(plant("a", "u", "y", "p", name)))


def compiles(names: list[str], folder: Path) -> None:
    """Each name as state, input, output, parameter and, but for that of a header, model: C and header compile."""
    steps = []
    for k, name in enumerate(names):
        state, input, output, parameter = (names[(k + shift) % len(names)] for shift in range(4))
        system = plant(state, input, output, parameter, name)
        steps.append(sampled(system))
    files: dict[str, str] = {}
    for step in steps:
        try:
            files |= hg.targets.c99(step, check=False)
        except HidesHeader:
            continue
    hg.write(files, folder)
    headers = "".join(f'#include "{name}"\n' for name in files if name.endswith(".h"))
    (folder / "all_c.h").write_text("".join(f"#include <{name}.h>\n" for name in C_HEADERS.split() if name != "iso646"))
    (folder / "all.c").write_text('#include "all_c.h"\n' + headers + "int all(void);\nint all(void) { return 0; }\n")
    (folder / "all.cpp").write_text("".join(f"#include <{name}>\n" for name in CPP_HEADERS.split()) + headers)
    sources = [name for name in files if name.endswith(".c")]
    run([tool("gcc"), "-std=gnu11", *WARNINGS, "-include", "all_c.h", "-fsyntax-only", "all.c", *sources], folder)
    run([tool("g++"), "-std=gnu++17", "-Wall", "-Wextra", "-Werror", "-fsyntax-only", "all.cpp"], folder)


def run(command: list[str], folder: Path) -> None:
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


@pytest.mark.full
def test_names_compile_wherever_they_stand(tmp_path: Path) -> None:
    names = NAMES.split()
    assert len(set(names)) == len(names) >= 200
    compiles(names[::12], tmp_path)


@pytest.mark.slow
def test_every_name_compiles_wherever_it_stands(tmp_path: Path) -> None:
    """Names that differ in case alone apart: on some systems their files are one."""
    names = NAMES.split()
    first = list({name.lower(): name for name in names}.values())
    others = [name for name in names if name not in first]
    assert len(others) >= 4
    compiles(first, tmp_path / "first")
    compiles(others, tmp_path / "others")
