"""What CasADi's operations are in emitted code: signs, and how tightly they bind, or functions by their names."""

import casadi as ca

from hgogen.emit.bounded_angles import BOUNDED_COS, BOUNDED_SIN, SMALL_COS, SMALL_SIN
from hgogen.emit.syntax import AND, EQUAL, OR, ORDER, PRODUCT, SUM

INFIX: dict[int, tuple[str, float]] = {
    ca.OP_ADD: (" + ", SUM),
    ca.OP_SUB: (" - ", SUM),
    ca.OP_MUL: ("*", PRODUCT),
    ca.OP_DIV: ("/", PRODUCT),
    ca.OP_LT: (" < ", ORDER),
    ca.OP_LE: (" <= ", ORDER),
    ca.OP_EQ: (" == ", EQUAL),
    ca.OP_NE: (" != ", EQUAL),
}
LOGIC: dict[int, float] = {ca.OP_AND: AND, ca.OP_OR: OR}  # whose signs are a language's own
CALLS: dict[int, str] = {
    ca.OP_FABS: "abs",
    ca.OP_FMIN: "min",
    ca.OP_FMAX: "max",
    ca.OP_FLOOR: "floor",
    ca.OP_SIGN: "sign",
    ca.OP_SQRT: "sqrt",
    ca.OP_EXP: "exp",
    ca.OP_LOG: "log",
    ca.OP_SIN: "sin",
    ca.OP_COS: "cos",
    BOUNDED_SIN: "bounded_sin",
    BOUNDED_COS: "bounded_cos",
    SMALL_SIN: "small_sin",
    SMALL_COS: "small_cos",
    ca.OP_TAN: "tan",
    ca.OP_ASIN: "asin",
    ca.OP_ACOS: "acos",
    ca.OP_ATAN: "atan",
    ca.OP_ATAN2: "atan2",
    ca.OP_SINH: "sinh",
    ca.OP_COSH: "cosh",
    ca.OP_TANH: "tanh",
    ca.OP_ASINH: "asinh",
    ca.OP_ACOSH: "acosh",
    ca.OP_ATANH: "atanh",
    ca.OP_POW: "pow",
    ca.OP_CONSTPOW: "pow",
    ca.OP_EXPM1: "expm1",
    ca.OP_LOG1P: "log1p",
    ca.OP_HYPOT: "hypot",
}
