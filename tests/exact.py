"""A reader that computes the bits of the emitted C: operation by operation, in its precision, with its functions."""

from functools import cache
from typing import Any

import casadi as ca
import numpy as np

from hgogen.emit.pygraph import evaluated
from hgogen.emit.syntax import DTYPE, Real
from hgogen.program import Block
from hgogen.step import Step
from hgogen.stepping.machine import Bound, Machine


def evaluate(function: ca.Function, arguments: list[Any], real: Real) -> list[list[Any]]:
    """The outputs of an SX function at arrays of numbers, every operation rounded to `real`."""
    operands = [np.asarray(argument, DTYPE[real]) for argument in arguments]
    return evaluated(function, real)([array.tolist() for array in operands] if real == "double" else operands)


def machine(step: Step, real: Real) -> Machine:
    """A machine that computes what the emitted C computes, bit for bit."""

    def bind(block: Block, arguments: list[np.ndarray]) -> Bound:
        results = [np.zeros(block.graph.numel_out(i), DTYPE[real]) for i in range(len(block.writes))]
        values_at = cache(lambda: evaluated(block.graph, real))  # a block that never runs is no text

        def run() -> None:
            operands = [array.tolist() for array in arguments] if real == "double" else arguments
            for array, numbers in zip(results, values_at()(operands), strict=False):
                array[:] = numbers

        return run, results

    return Machine(step, bind, DTYPE[real])
