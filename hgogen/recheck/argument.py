"""The slopes of an observer that puts the output error into the argument of b, z + N_theta (y - C z).

b reads of z_j the error e_j - sum_k N_jk (a_(k,1) e_k - v_k), e_k that of the first state of chain k, v_k that of its
sample; N_theta has N_jk times theta^(p(j) - p(k)), p the powers that scale states, so that the coordinates S z over
theta^p are free of theta: e_j - sum_k (S_j/S_k) N_jk a_(k,1) e_k + S_j N_jk v_k theta^-p(k).
"""

from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction

from .box import NotShown
from .chain import gain_of
from .context import Context
from .matrix import unit
from .text import Expression


@dataclass(frozen=True)
class Argument:
    """What b reads in the place of z_j: `reads` (n) of the errors, and `takes` (p) of those of the samples, over their
    powers of theta; these empty where they are no numbers."""

    reads: list[list[Fraction]]
    takes: list[list[Fraction]]

    @property
    def heard(self) -> bool:
        """Whether it is known what b takes of the samples."""
        return all(self.takes)


def argument_of(context: Context, entries: Sequence[Expression], scale: Sequence[Expression]) -> Argument:
    """By the entries of N, for each z_j, in the coordinates `scale` z.

    Raises: `NotShown` where what b reads of the errors is not of numbers.
    """
    S = [context.value(text) for text in scale]
    N = gain_of(context.form.blocks, [context.value(text) for text in entries], context.algebra.number(Fraction(0)))
    reads, takes = unit(len(N)), [[(s * entry).number for entry in row] for s, row in zip(S, N, strict=True)]
    for k, z in enumerate(context.heads):
        if not z:
            continue
        head, a = context.z.index(z), context.first_gain(k)
        for j, row in enumerate(N):
            share = (row[k] * a * S[j] / S[head]).number
            if share is None:
                raise NotShown("what it injects into the argument of b is not of numbers in these coordinates")
            reads[j][head] -= share
    known = [[value for value in row if value is not None] for row in takes]
    return Argument(reads, known if all(len(row) == len(context.heads) for row in known) else [[] for _ in N])
