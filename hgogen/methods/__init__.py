"""Methods: each file is a case, a value that turns differential equations into statements.

It has the interface of `Method` in `hgogen/method.py`. An explicit Runge-Kutta method is its tableau in
`hgogen/discretisation/runge_kutta.py` and a file of one line, as `heun.py`.
"""

from hgogen.registry import cases_of

__all__, __dir__, __getattr__ = cases_of(__name__)
