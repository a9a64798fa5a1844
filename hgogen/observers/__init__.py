"""Observers: each file is a case, a function from a Form to an Observer.

Its docstring opens with the equations and the reference; its theorem is data, each hypothesis with the checks that know
it. It begins with `founded`, which gives what every observer demands: a form, none of whose hypotheses is refuted and
not accepted, and that it takes. Above it `starts` ties the words of its row in docs/observers.md and a rule for its
starting gains, or a sentence why it has none; the rule reads a `Scale` of `hgogen/starting.py`, the ranges of the plant
in numbers. Its `claims` make its checks when these are first read; a check that can be refuted is made before the
observer, and `demand` asks for it. What it remembers beside its estimate is a `Field` of `hgogen/program.py`, and a
CasADi expression is a `Graph`. The commands, `hgogen check` and the tests of every observer try it on each model with
these gains, unless the model's tuning holds better ones; without gains of either kind its tests are skipped. Copy
`low_power.py` for one on a chain of integrators, `high_gain.py` for one that takes several outputs or A(u).
"""

from hgogen.observer import remembered
from hgogen.reading.given import requires_switches
from hgogen.registry import cases_of

__all__, __dir__, __getattr__ = cases_of(__name__, lambda case: requires_switches(remembered(case)))
