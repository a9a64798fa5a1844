"""The mark of memory: a number that init and reset leave in a state, and init in parameters, and that other memory is
unlikely to hold.

Every entry that a caller has asks for it first. Memory without it (zeros, what a stack held, what another program left)
is not used, and the status says so: a state begins anew; with parameters no sample is taken, and the state begins anew.
The number has 16 bits, which the smallest `unsigned` of C holds, and two bytes that differ, neither of them 0x00 or
0xFF: memory that was filled with one byte has no mark. It is made of a digest of the program (`hgogen.emit.saved`), so
that memory of two programs is told apart but for one pair in 64262.
"""

from hgogen.program import Bit, scalar

UNINITIALISED = Bit(
    "UNINITIALISED",
    "the memory of the state was none that init or reset had made, or one of another program: it was not used, the "
    "state began as before the first call",
    "call init once before all else; of a state that was restored, check what was saved",
)
NO_PARAMETERS = Bit(
    "NO_PARAMETERS",
    "the memory of the parameters was none that init or PARAMS_INIT had made, or of another program: tune took the "
    "nominal values, any other call took no sample and left the state as before the first call",
    "call init once before all else, or begin constant parameters with PARAMS_INIT",
)
UNMADE = (UNINITIALISED, NO_PARAMETERS)  # what no block raises: an entry does
MARK = scalar("ready", 0, kind="index", meaning="what init and reset leave here; a state without it begins anew")
OF_PARAMETERS = "what init and PARAMS_INIT leave here; parameters without it are not used"
_LEAST, _MOST = 0x01, 0xFE  # of a byte


def number(digest: bytes) -> int:
    """Return the mark of the programs with this digest."""
    high, low = _LEAST + digest[0] % (_MOST - _LEAST + 1), _LEAST + digest[1] % (_MOST - _LEAST)
    return (high << 8) + low + (low >= high)  # so that the bytes differ
