"""The mark of a state: a number that init and reset leave in it, and that other memory is unlikely to hold.

Every entry that a caller has asks for it first. Memory without it (zeros, what a stack held, a state of another
program) was never made a state: it begins anew, and the status says so. The number has 16 bits, which the smallest
`unsigned` of C holds, and two bytes that differ, neither of them 0x00 or 0xFF: memory that was filled with one byte is
no state. It is made of the names and sizes of what is remembered, and of those of the model, the form and the observer,
so that states of two programs are told apart but for one pair in 64262.
"""

import hashlib
from collections.abc import Iterable, Iterator

from hgogen.observer import Observer
from hgogen.program import Bit, Field, Group, scalar

UNINITIALISED = Bit(
    "UNINITIALISED",
    "the memory of the state was none that init or reset had made, or one of another program: it was not used, the "
    "state began as before the first call",
    "call init once before all else; of a state that was restored, check what was saved",
)
_LEAST, _MOST = 0x01, 0xFE  # of a byte


def mark(observer: Observer, fields: Iterable[Field], groups: Iterable[Group]) -> Field:
    """The field that holds it in a state of these fields and groups."""
    form = observer.form
    text = "\n".join((form.system.name, form.kind, observer.name, *_listed(fields, groups)))
    high, low, *_ = hashlib.sha256(text.encode()).digest()
    high, low = _LEAST + high % (_MOST - _LEAST + 1), _LEAST + low % (_MOST - _LEAST)
    number = (high << 8) + low + (low >= high)  # so that the bytes differ
    meaning = "what init and reset leave here; a state without it begins anew"
    return scalar("ready", number, kind="index", low=number, high=number, meaning=meaning)


def _listed(fields: Iterable[Field], groups: Iterable[Group]) -> Iterator[str]:
    """The layout of a state in words."""
    yield from (f"{field.kind} {field.name}[{field.size}]: {', '.join(field.labels)}" for field in fields)
    for group in groups:
        yield f"{group.name}[{group.count}]"
        yield from _listed(group.fields, group.groups)
