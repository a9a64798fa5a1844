"""The status word of a step: which bits each signal may have, in order, how wide the word is, and what is too many."""

from collections import Counter
from collections.abc import Container, Iterable, Mapping, Sequence

import numpy as np

from hgogen.program import Bit
from hgogen.signal import Signal
from hgogen.stepping.guards import SIGNAL_BITS, STEP_BITS

CERTAIN_BITS, DATED_BITS = ("MISSING", "REJECTED"), ("LATE", "EARLY", "REPEATED")  # of each output; of a dated one
OUTPUT_BITS = (*CERTAIN_BITS, "UNDEFINED", *DATED_BITS, "UNDATED")  # in the order of the word
RATE_BITS = ("HELD",)
INPUT_BITS = ("REUSED", "CLAMPED")
WIDTHS = (32, 64)  # bits of a status word
EXACT = 32  # bits of one that is told as real numbers, of which each has 53


def word(bits: Sequence[Bit]) -> np.dtype:
    """Return numpy's type of the narrowest status word that holds these bits."""
    return np.dtype(f"u{next(size for size in WIDTHS if len(bits) <= size) // 8}")


def possible_bits(
    outputs: Iterable[Signal], inputs: Iterable[Signal], rates: Iterable[Signal], beyond: Mapping[Signal, str]
) -> list[Bit]:
    """Return the bits that a status may have, in the order of the word: those of each output, of each state whose rate
    may be held, of each input, of the step; `beyond`: when a sample of an output is implausible."""
    bits = []
    for signals, kinds in ((outputs, OUTPUT_BITS), (rates, RATE_BITS), (inputs, INPUT_BITS)):
        for signal in signals:
            for kind in kinds:
                meaning, action = SIGNAL_BITS[kind]
                bits.append(
                    Bit(f"{kind}_{signal.name}", meaning.format(signal.name, beyond=beyond.get(signal)), action)
                )
    return bits + [Bit(name, meaning, action) for name, (meaning, action) in STEP_BITS.items()]


def certain_bits(outputs: Iterable[Signal], inputs: Iterable[Signal], dated: Container[str] = ()) -> list[str]:
    """Return the names of the bits that every step with guards has of these signals, as their declaration tells;
    `dated`: the names of the outputs whose samples say when they were taken."""
    of_outputs = [
        f"{kind}_{each}" for each in outputs for kind in (*CERTAIN_BITS, *(DATED_BITS if each.name in dated else ()))
    ]
    return of_outputs + [f"{kind}_{each.name}" for each in inputs for kind in INPUT_BITS[: 1 + each.bounded]]


def shortage(names: Sequence[str]) -> str:
    """Return what is wrong with a status of bits of these names: what takes them, and a way out; "" where they fit."""
    most, kinds = WIDTHS[-1], (*OUTPUT_BITS, *RATE_BITS, *INPUT_BITS)
    if len(names) <= most:
        return ""
    counts = Counter(next((kind for kind in kinds if name.startswith(f"{kind}_")), "") for name in names)
    taken = [f"{kind} for {counts[kind]} signals" for kind in kinds if counts[kind]]
    taken += [f"{counts['']} for the whole step"] * bool(counts[""])
    return (
        f"has more than {most}: {', '.join(taken)}; drop outputs, inputs or ranges of inputs, or take "
        'guards="none", which has no status'
    )
