"""Block-triangular forms for several outputs: a triangular chain for each output.

    z_(i,j)' = a_(i,j+1)(u) z_(i,j+1) + b_(i,j)(z, u),   j < n_i,
    z_(i,n_i)' = b_(i,n_i)(z, u),   y_i = a_(i,1)(u) z_(i,1),   0 < a_m <= a_(i,j) <= a_M.

What b_(i,j) may read is the alignment of the chains:

    top       z_(k,l) for l <= j                  Delta_i = diag(1, .., theta^-(n_i - 1))
    end       z_(k,l) for l <= j + n_k - n_i      Delta_i = diag(theta^-(n* - n_i), .., theta^-(n* - 1)), n* = max n_i
    cascade   z_(i,l) for l <= j, and all states of the chains before

An output that adds nothing, as a second sensor of the same state, has a chain of length 0: those of the others hold all
states. One that is a multiple of the first output of a chain enters the mean of its readings (`structure.spare`).
z is the plant's state in another order, some with the other sign, chain by chain in the order of the outputs.

N. Boizot, "Adaptive high-gain extended Kalman filter and applications", thesis (2010), chapter 5, for the ends;
N. Boizot, E. Busvelle, J.-P. Gauthier, Automatica 46 (2010), form (3), for one chain.
"""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from itertools import combinations

import sympy as sp

from hgogen.check import Check, ClaimId, Verdict
from hgogen.errors import HgogenError
from hgogen.evidence.grounds import ByForm
from hgogen.form import Asking, Form
from hgogen.reading.given import among
from hgogen.sentence import because
from hgogen.structure.chain import Chains, Link, Rows, Shape, levelwise, of_plant
from hgogen.structure.chord import settled, signs_of
from hgogen.structure.connected import cut_off
from hgogen.structure.coordinates import Coordinates, Parts, coordinates, form_in
from hgogen.structure.defined import defined
from hgogen.structure.lipschitz import lipschitz
from hgogen.structure.positive import positive
from hgogen.structure.several import cascade, end_aligned
from hgogen.system import System

_MANY = 6  # outputs: of more it is not asked which are enough, for there are too many choices
_REFERENCE = "Boizot, thesis (2010), chapter 5"
# Alignment to the search for its chains and what a row may read.
_ALIGNMENTS: Mapping[str, tuple[Callable[[Rows], Chains], str]] = {
    "top": (levelwise, "states of its level and before, of every chain"),
    "end": (end_aligned, "states no nearer to the end of their chain than its own"),
    "cascade": (cascade, "states before it in its own chain, and all states of the chains before"),
}


@dataclass(eq=False)
class NoAlignment(HgogenError):
    """A name that is no alignment."""

    name: object

    def __str__(self) -> str:
        return f"align={self.name!r} is none of {', '.join(_ALIGNMENTS)}; leave it out to take the first that is proved"


@dataclass(frozen=True)
class _Chain:
    """Links in the plant's coordinates, with the sign of each z: rows s * row, states t * state."""

    links: tuple[Link, ...]
    signs: tuple[int, ...]

    @property
    def gains(self) -> list[sp.Expr]:
        """The gains a_1..a_n."""
        before = (1, *self.signs)
        return [s * link.gain * t for s, link, t in zip(before, self.links, self.signs, strict=False)]

    @property
    def rests(self) -> list[sp.Expr]:
        """The output's offset, then b_1..b_{n-1}."""
        return [s * link.rest for s, link in zip((1, *self.signs), self.links, strict=False)]


@Asking(3, ({"align": "top"}, {"align": "end"}, {"align": "cascade"}), least=2)
def block_triangular(plant: System, align: str | None = None) -> Form:
    """The plant in block-triangular form, by permutation and sign.

    Args: `align` is "top", "end" or "cascade"; without it the first of these that is proved, else the first that is
    not refuted.

    Checks: `block_triangular.structure`, of the alignment; `block_triangular.a_i_j` (0 < a_m <= a_(i,j) <= a_M on the
    box of inputs and parameters); `block_triangular.offset_i` where output i has one; `block_triangular.lipschitz`. A
    plant without the structure comes back in its own order with that one check, and `block_triangular.connected`,
    refuted, where states are hidden from the outputs.

    Raises: `NoAlignment`.
    """
    if not (align is None or among(align, _ALIGNMENTS)):
        raise NoAlignment(align)
    rows = of_plant(plant)
    name, chains = _chosen(rows, align)
    answer, why = chains.answer(Shape.CONSTANT)
    spare = [y for y, links in zip(plant.outputs, chains.links, strict=False) if not links]
    why = because("{why}; {outputs: and } without a chain", why=why, outputs=spare) if answer and spare else why
    verdict = Verdict.PROVED if answer else Verdict.UNKNOWN if answer is None else Verdict.REFUTED
    structure = Check(
        ClaimId("block_triangular", "structure"),
        f"each row brings in the next state of its chain, linearly, and reads {_ALIGNMENTS[name][1]} ({name})",
        verdict,
        why,
        fix="" if answer else "Try another alignment.",
        proofs=(ByForm(),) if answer else (),
    )
    if chains.broken or answer is False:
        refused = (structure, *cut_off("block_triangular", plant))
        return form_in(coordinates(plant), "block_triangular", refused, _REFERENCE)
    chosen = [tuple(settled(link, Shape.CONSTANT, plant) for link in links) for links in chains.links]
    signed = [_Chain(links, tuple(signs_of(links, plant))) for links in chosen]
    z = coordinates(plant, chains.order, [t for chain in signed for t in chain.signs])
    parts = _, b, _ = _parts(z, signed)
    steep = lipschitz("block_triangular", map(z.back, b), plant)
    checks = (structure, *_claims(signed, plant), steep)
    blocks = chains.blocks
    return form_in(z, "block_triangular", checks, _REFERENCE, parts=parts, blocks=blocks, alignment=name)


def _chosen(rows: Rows, align: str | None) -> tuple[str, Chains]:
    """The alignment, with a chain for each output, else of the most outputs that are enough."""
    name, chains = best = _of_all(rows, align)
    if chains.answer(Shape.CONSTANT)[0]:
        return best
    count = len(rows.output)
    sizes = range(count - 1, 0, -1) if count <= _MANY else ()
    for left in (left for size in sizes for left in combinations(range(count), size)):
        few = replace(rows, names=tuple(rows.names[j] for j in left), output=tuple(rows.output[j] for j in left))
        name, chains = _of_all(few, align)
        if chains.answer(Shape.CONSTANT)[0]:
            links = dict(zip(left, chains.links, strict=True))
            return name, replace(chains, links=tuple(links.get(j, ()) for j in range(count)))
    return best


def _of_all(rows: Rows, align: str | None) -> tuple[str, Chains]:
    tried = {name: search(rows) for name, (search, _) in _ALIGNMENTS.items() if align in (None, name)}
    answers = {name: chains.answer(Shape.CONSTANT)[0] for name, chains in tried.items()}
    best = next((name for wanted in (True, None, False) for name, is_so in answers.items() if is_so is wanted))
    return best, tried[best]


def _parts(z: Coordinates, chains: list[_Chain]) -> Parts:
    """A, b and the output, in z."""
    n = len(z.states)
    A, b, output, head = sp.zeros(n, n), list(z.flow), [], 0
    for chain, row in zip(chains, z.output, strict=True):
        if not chain.links:
            output.append(row)
            continue
        gains, rests = chain.gains, [z.carry(rest) for rest in chain.rests]
        output.append(gains[0] * z.states[head] + rests[0])
        for i, (gain, rest) in enumerate(zip(gains[1:], rests[1:], strict=True), head):
            A[i, i + 1], b[i] = gain, rest
        head += len(gains)
    return sp.ImmutableDenseMatrix(A), tuple(b), tuple(output)


def _claims(chains: list[_Chain], plant: System) -> Iterator[Check]:
    for i, chain in enumerate(chains, 1):
        for j, gain in enumerate(chain.gains, 1):
            yield positive(ClaimId("block_triangular", "a", i, j), f"a_({i},{j})", gain, plant)
    for i, chain in ((i, chain) for i, chain in enumerate(chains, 1) if chain.links):
        offset = chain.rests[0]
        if offset != 0 and offset.free_symbols.isdisjoint(plant.states):
            yield defined(ClaimId("block_triangular", "offset", i), f"c_{i}", offset, plant)
