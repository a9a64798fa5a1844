"""Observers: each file is a case, a function from a Form to an Observer.

The docstring of a file opens with the equations and the reference. The theorem is data: each hypothesis names the
checks that decide it. The function first calls `demand_form`, which raises unless the argument is a form that the
observer accepts and no hypothesis of it is refuted without being accepted. The decorator `starts` gives the words of
the observer's row in docs/observers.md and a rule for its starting gains, or a sentence why it has none; the rule reads
a `Scale` of `hgogen/starting.py`, the ranges of the plant in numbers. `claims` makes the checks when they are first
read; a check that can be refuted is made before the observer, and `demand` raises for it. Further memory is a `Field`
of `hgogen/program.py`; a CasADi expression is a `Graph`. The commands, `hgogen check` and the tests of every observer
try the observer on each model with these gains, unless the model's tuning holds better ones; without gains of either
kind its tests are skipped. Copy `low_power.py` for an observer on a chain of integrators, `high_gain.py` for several
outputs or A(u).
"""

from typing import Any

from hgogen.estimators.synonyms import SYNONYMS, observer_called
from hgogen.observer import cached_observers
from hgogen.reading.given import requires_switches
from hgogen.registry import cases_of

__all__, __dir__, _case_called = cases_of(__name__, lambda case: requires_switches(cached_observers(case)))


def __getattr__(name: str) -> Any:
    return observer_called(name, _case_called) if name in SYNONYMS else _case_called(name)
