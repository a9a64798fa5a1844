"""Recorded vectors for the self-check of emitted C: what goes in, and what must come out, bit for bit.

The inputs are triangle waves over the declared ranges, with a missing and an absurd sample among them, so that guards,
correction and adaptation all run; they use no function of this machine. The outputs are those of `hgogen.exact`.
"""

from dataclasses import dataclass

import numpy as np

from hgogen.cprint import Real
from hgogen.exact import DTYPE, machine
from hgogen.signal import Signal
from hgogen.step import Step

SAMPLES = 64
MISSING, ABSURD, LOST_INPUT = 20, 30, 40  # samples at which a guard is exercised


@dataclass(frozen=True)
class Vectors:
    """Inputs u (N, m), outputs y (N, p), estimates x (N, n) in the working precision, and status (N)."""

    u: np.ndarray
    y: np.ndarray
    x: np.ndarray
    status: np.ndarray


def record(step: Step, real: Real) -> Vectors:
    """Run the step from a reset over the test inputs."""
    u = np.array(
        [[_wave(k, s, 37, LOST_INPUT, -1) for s in step.inputs] for k in range(SAMPLES)], DTYPE[real]
    )
    y = np.array(
        [[_wave(k, s, 23, MISSING, ABSURD) for s in step.outputs] for k in range(SAMPLES)], DTYPE[real]
    )
    reader = machine(step, real)
    x, status = np.zeros((SAMPLES, len(step.states)), DTYPE[real]), np.zeros(SAMPLES, np.uint32)
    for k in range(SAMPLES):
        for row, signals, kind in ((u[k], step.inputs, "input"), (y[k], step.outputs, "output")):
            for value, signal in zip(row, signals, strict=True):
                reader.memory[f"{kind}.{signal.name}"][0] = value
        status[k] = reader.call()
        x[k] = [reader.memory[f"estimate.{s.name}"][0] for s in step.states]
    return Vectors(u.reshape(SAMPLES, -1), y, x, status)


def _wave(k: int, signal: Signal, period: int, missing: int, absurd: int) -> float:
    """Half the declared range (or +-1) about its middle, in a triangle."""
    if k == missing:
        return float("nan")
    if k == absurd:
        return 1e30
    low, high = signal.interval if signal.bounded else (-1.0, 1.0)
    phase = (k % period) / period
    triangle = 1 - 4 * abs(phase - 0.5)
    return (low + high) / 2 + (high - low) / 4 * triangle
