"""The one place that knows all kinds of parts: which rule makes memory and statements of each."""

from hgogen.innovation import Predictors
from hgogen.kalman.curvature import Curved, curved
from hgogen.kalman.riccati import Riccati
from hgogen.method import Method
from hgogen.part import Clock, Jump, Ode, Part, Pieces
from hgogen.stepping.parallel import Parallel, parallel


def pieces(part: Part, method: Method, clock: Clock) -> Pieces:
    """A part as memory and statements.

    Raises: what the method raises of a part that it does not take.
    """
    match part:
        case Ode():
            return method.ode(part, clock)
        case Riccati():
            return method.riccati(part, clock)
        case Curved():
            return curved(part, method, clock)
        case Predictors(predictor=predictor, build=build):
            return build(predictor, clock)
        case Jump(build=build):
            return build(clock)
        case Parallel():
            return parallel(part, clock, lambda each, own: pieces(each, method, own))
    raise TypeError(f"no rule makes statements of a {type(part).__name__}")
