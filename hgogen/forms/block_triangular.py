"""Block-triangular forms for several outputs: a triangular chain for each output.

    z_(i,j)' = a_(i,j+1)(u) z_(i,j+1) + b_(i,j)(z, u),   j < n_i,
    z_(i,n_i)' = b_(i,n_i)(z, u),   y_i = a_(i,1)(u) z_(i,1),   0 < a_m <= a_(i,j) <= a_M.

What b_(i,j) may read is the alignment of the chains:

    top       z_(k,l) for l <= j                  Delta_i = diag(1, .., theta^-(n_i - 1))
    end       z_(k,l) for l <= j + n_k - n_i      Delta_i = diag(theta^-(n* - n_i), .., theta^-(n* - 1)), n* = max n_i
    cascade   z_(i,l) for l <= j, and all states of the chains before

A redundant output, such as a second sensor of the same state, has a chain of length 0: the other chains hold all
states. An output that is a multiple of the first state of a chain enters the mean of that state's readings
(`analysis.scaling`). z is a permutation of the plant's state, chain by chain in the order of the outputs, with some
signs reversed.

N. Boizot, "Adaptive high-gain extended Kalman filter and applications", thesis (2010), chapter 5, for the ends;
N. Boizot, E. Busvelle, J.-P. Gauthier, Automatica 46 (2010), form (3), for one chain.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from itertools import combinations

from hgogen.analysis.chain import (
    Chains,
    Rows,
    Shape,
    cascade,
    cut_off_check,
    end_aligned,
    levelwise,
    of_plant,
    structure,
)
from hgogen.analysis.coordinates import coordinates, form_in, triangle
from hgogen.errors import HgogenError
from hgogen.form import Form, SurveySettings
from hgogen.reading.given import among
from hgogen.sentence import because
from hgogen.system import System

_MANY = 6  # outputs: with more there are too many subsets to try
_REFERENCE = "Boizot, thesis (2010), chapter 5"
# Alignment to the search for its chains and what a row may read.
_ALIGNMENTS: Mapping[str, tuple[Callable[[Rows], Chains], str]] = {
    "top": (levelwise, "states of its level and before, of every chain"),
    "end": (end_aligned, "states no nearer to the end of their chain than its own"),
    "cascade": (cascade, "states before it in its own chain, and all states of the chains before"),
}


@dataclass(eq=False)
class NoAlignment(HgogenError):
    """The error that the argument `align` is none of "top", "end", "cascade"."""

    name: object
    text = "align={name!r} is none of top, end, cascade; leave it out to take the first that is proved"


@SurveySettings(3, ({"align": "top"}, {"align": "end"}, {"align": "cascade"}), least=2)
def block_triangular(plant: System, align: str | None = None) -> Form:
    """Return the plant in block-triangular form, with a chain of states for each output, z_(i,j)' = a_(i,j+1)(u)
    z_(i,j+1) + b_(i,j)(z, u), y_i = a_(i,1)(u) z_(i,1), by permutation and sign of its states.

    Args: `align`: "top", "end" or "cascade", the states on which b may depend; by default the first of these that is
    proved, else the first that is not refuted.

    Checks: `block_triangular.structure`, of the alignment; `block_triangular.a_i_j` (0 < a_m <= a_(i,j) <= a_M on the
    box of inputs and parameters); `block_triangular.offset_i` where output i has one; `block_triangular.lipschitz`. A
    plant without the structure keeps its own order and has only that check, and a refuted `block_triangular.connected`
    where no output depends on some states.

    Raises: `NoAlignment`.
    """
    if not (align is None or among(align, _ALIGNMENTS)):
        raise NoAlignment(align)
    rows = of_plant(plant)
    name, chains = _chosen(rows, align)
    answer, why = chains.answer(Shape.CONSTANT)
    spare = [y for y, links in zip(plant.outputs, chains.links, strict=False) if not links]
    why = because("{why}; {outputs: and } without a chain", why=why, outputs=spare) if answer and spare else why
    reads = f"reads {_ALIGNMENTS[name][1]} ({name})"
    claim = f"each equation brings in the next state of its chain, linearly, and {reads}"
    check = structure("block_triangular", claim, (answer, why), "Try another alignment.")
    if chains.broken or answer is False:
        refused = (check, *cut_off_check("block_triangular", plant))
        return form_in(coordinates(plant), "block_triangular", refused, _REFERENCE)
    return triangle(check, _REFERENCE, plant, chains, Shape.CONSTANT, blocks=chains.blocks, alignment=name)


def _chosen(rows: Rows, align: str | None) -> tuple[str, Chains]:
    name, chains = best = _of_all(rows, align)
    if chains.answer(Shape.CONSTANT)[0]:
        return best
    count = len(rows.output)
    sizes = range(count - 1, 0, -1) if count <= _MANY else ()
    for subset in (subset for size in sizes for subset in combinations(range(count), size)):
        reduced = replace(
            rows, names=tuple(rows.names[j] for j in subset), output=tuple(rows.output[j] for j in subset)
        )
        name, chains = _of_all(reduced, align)
        if chains.answer(Shape.CONSTANT)[0]:
            links = dict(zip(subset, chains.links, strict=True))
            return name, replace(chains, links=tuple(links.get(j, ()) for j in range(count)))
    return best


def _of_all(rows: Rows, align: str | None) -> tuple[str, Chains]:
    tried = {name: search(rows) for name, (search, _) in _ALIGNMENTS.items() if align in (None, name)}
    answers = {name: chains.answer(Shape.CONSTANT)[0] for name, chains in tried.items()}
    best = next((name for wanted in (True, None, False) for name, holds in answers.items() if holds is wanted))
    return best, tried[best]
