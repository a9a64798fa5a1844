"""The same sample of a filter by other libraries: each writes `peer_step(w, before, row, next)` in C or C++.

CasADi prints float as double: its constants get an f, its functions those of float, as SymPy's do. SymForce writes a
template of C++ on Eigen's matrices; Eigen itself is written by hand, with the model from SymPy. A peer that is not
installed is left out by name.
"""

import math
import re
import shutil
import tempfile
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path

import casadi as ca
import mathematics
import sympy as sp
from cases import Case

LARGEST = {"sympy": 10, "symforce": 20, "eigen": 40, "casadi": 40}  # states, beyond which it takes minutes
EIGEN = Path("/usr/include/eigen3")
_CONSTANT = re.compile(r"(?<![\w.])(\d+\.\d*(?:[eE][+-]?\d+)?|\d+[eE][+-]?\d+)(?![\w.])")
_FUNCTION = re.compile(r"\b(sin|cos|tan|exp|log|sqrt|fabs|fmin|fmax|pow|floor)\(")


@dataclass(frozen=True)
class Source:
    """The text of a peer, in the language "c" or "c++"."""

    text: str
    language: str = "c"


class Missing(LookupError):
    """A library that is not there, or a case that it does not take."""


def single(text: str) -> str:
    """A text of C in double as one of float."""
    return _FUNCTION.sub(r"\1f(", _CONSTANT.sub(r"\1f", text))


def _sizes(case: Case) -> tuple[int, int]:
    """Of w, and of a row."""
    return case.n + case.n * (case.n + 1) // 2, len(case.inputs) + len(case.R)


def casadi_function(case: Case) -> ca.Function:
    """(w, the row before, a row) -> w after the row."""
    a, b = _sizes(case)
    entries = [ca.SX.sym(name, size) for name, size in (("w", a), ("before", b), ("row", b))]
    sample = mathematics.sample(case, mathematics.model(case, ca))
    return ca.Function("casadi_step", entries, [ca.vertcat(*sample(*map(ca.vertsplit, entries)))], {"cse": True})


def casadi(case: Case, real: str) -> Source:
    """One function of CasADi's graphs, by its own code generator."""
    made = casadi_function(case)
    generator = ca.CodeGenerator("casadi_step.c", {"casadi_real": real})
    generator.add(made)
    text = generator.dump()
    body = single(text) if real == "float" else text
    call = f"""
void peer_step(const {real} *w, const {real} *before, const {real} *row, {real} *next)
{{
    static {real} work[{made.sz_w() + 1}];
    static casadi_int integers[{made.sz_iw() + 1}];
    const {real} *arg[{made.sz_arg()}] = {{w, before, row}};
    {real} *res[{made.sz_res()}] = {{next}};
    casadi_step(arg, res, integers, work, 0);
}}
"""
    return Source(body + call)


def sympy(case: Case, real: str) -> Source:
    """SymPy's common subexpressions and printer."""
    a, b = _sizes(case)
    entries = [[sp.Symbol(f"{name}[{i}]") for i in range(size)] for name, size in (("w", a), ("before", b), ("row", b))]
    ends = mathematics.sample(case, mathematics.model(case, sp))(*entries)
    shared, reduced = sp.cse([sp.sympify(e) for e in ends], order="none")
    lines = [f"    const {real} {name} = {sp.ccode(value)};" for name, value in shared]
    lines += [f"    next[{i}] = {sp.ccode(value)};" for i, value in enumerate(reduced)]
    body = "\n".join(lines)
    head = f"void peer_step(const {real} *w, const {real} *before, const {real} *row, {real} *next)"
    return Source(f"#include <math.h>\n{head}\n{{\n{single(body) if real == 'float' else body}\n}}\n")


def symforce(case: Case, real: str) -> Source:
    """SymForce's code generator, which writes a template."""
    if find_spec("symforce") is None or shutil.which("clang-format") is None:
        raise Missing("symforce and clang-format are not installed")
    import symforce as library

    if "symengine" not in library.get_symbolic_api():
        library.set_symbolic_api("symengine")
    import symforce.symbolic as sf
    from symforce.codegen import Codegen, CppConfig
    from symforce.values import Values

    a, b = _sizes(case)
    entries = Values(**{n: sf.Matrix(s, 1).symbolic(n) for n, s in (("w", a), ("before", b), ("row", b))})
    sample = mathematics.sample(case, mathematics.model(case, sf))
    ends = sample(*([entry[i, 0] for i in range(entry.shape[0])] for entry in entries.values()))
    code = Codegen(entries, Values(next=sf.Matrix(ends)), CppConfig(), name="symforce_step", return_key="next")
    with tempfile.TemporaryDirectory() as folder:
        made = code.generate_function(output_dir=folder, skip_directory_nesting=True)
        text = Path(made.generated_files[0]).read_text()
    named = re.search(r"> (\w+)\(const Eigen", text)
    assert named is not None
    call = f"""
extern "C" void peer_step(const {real} *w, const {real} *before, const {real} *row, {real} *next)
{{
    using W = Eigen::Matrix<{real}, {a}, 1>;
    using Row = Eigen::Matrix<{real}, {b}, 1>;
    Eigen::Map<W>{{next}} = sym::{named[1]}<{real}>(
        Eigen::Map<const W>{{w}}, Eigen::Map<const Row>{{before}}, Eigen::Map<const Row>{{row}});
}}
"""
    return Source(text.replace("#pragma once", "") + call, "c++")


def eigen(case: Case, real: str) -> Source:
    """Matrices of fixed size, by hand."""
    if not EIGEN.is_dir():
        raise Missing("Eigen is not installed (libeigen3-dev)")
    n, m, p = case.n, len(case.inputs), len(case.R)

    def rows(name: str, matrix: sp.Matrix) -> str:
        entries = {(i, j): e for i in range(matrix.rows) for j in range(matrix.cols) if (e := matrix[i, j]) != 0}
        lines = [f"    {name}({i}, {j}) = {_printed(case, e, real)};" for (i, j), e in entries.items()]
        return "\n".join(lines)

    x = sp.Matrix(case.states)
    text = _EIGEN.format(
        real=real,
        n=n,
        m=m,
        p=p,
        h=repr(case.step.dt),
        flow=rows("f", case.flow),
        jacobian=rows("F", case.flow.jacobian(x)),
        output=rows("h", case.output),
        slope=rows("H", case.output.jacobian(x)),
        Q=", ".join(map(repr, case.Q)),
        R=", ".join(map(repr, case.R)),
        body=_EIGEN_STEP[case.method],
    )
    return Source(single(text) if real == "float" else text, "c++")


def _printed(case: Case, e: sp.Expr, real: str) -> str:
    places = {**{s: sp.Symbol(f"z[{i}]") for i, s in enumerate(case.states)}}
    places |= {s: sp.Symbol(f"u[{i}]") for i, s in enumerate(case.inputs)}
    return str(sp.ccode(e.xreplace(places)))


_EIGEN = """
#include <Eigen/Core>
#include <cmath>
namespace {{
using Z = Eigen::Matrix<{real}, {n}, 1>;
using U = Eigen::Matrix<{real}, {m}, 1>;
using Y = Eigen::Matrix<{real}, {p}, 1>;
using N = Eigen::Matrix<{real}, {n}, {n}>;
using P = Eigen::Matrix<{real}, {p}, {n}>;
const {real} dt = {h};

inline Z flow(const Z &z, const U &u)
{{
    Z f = Z::Zero();
{flow}
    return f;
}}

inline N jacobian(const Z &z, const U &u)
{{
    N F = N::Zero();
{jacobian}
    return F;
}}

inline Y output(const Z &z, const U &u)
{{
    Y h = Y::Zero();
{output}
    return h;
}}

inline P slope(const Z &z, const U &u)
{{
    P H = P::Zero();
{slope}
    return H;
}}

inline void take(const {real} *w, Z &z, N &P_)
{{
    for (int i = 0, k = {n}; i < {n}; ++i) {{
        z[i] = w[i];
        for (int j = 0; j <= i; ++j, ++k) {{
            P_(i, j) = P_(j, i) = w[k];
        }}
    }}
}}

inline void give(const Z &z, const N &P_, {real} *w)
{{
    for (int i = 0, k = {n}; i < {n}; ++i) {{
        w[i] = z[i];
        for (int j = 0; j <= i; ++j, ++k) {{
            w[k] = P_(i, j);
        }}
    }}
}}
}} // namespace

extern "C" void peer_step(const {real} *w, const {real} *before, const {real} *row, {real} *next)
{{
    const Z Q = (Z() << {Q}).finished();
    const Y R = (Y() << {R}).finished();
    Z z;
    N S;
    take(w, z, S);
    const U u0 = Eigen::Map<const U>{{before}}, u1 = Eigen::Map<const U>{{row}}, um = u0 + (u1 - u0)/2;
    const Y y0 = Eigen::Map<const Y>{{before + {m}}}, y1 = Eigen::Map<const Y>{{row + {m}}}, ym = y0 + (y1 - y0)/2;
{body}
    give(z, S, next);
}}

extern "C" void *_sbrk(int)  // of the board, which has no memory to give
{{
    return reinterpret_cast<void *>(-1);
}}
"""
_EIGEN_STEP = {
    "continuous_discrete": """
    const Z k1 = flow(z, u0);
    const Z k2 = flow(z + dt/2*k1, um);
    const Z third = z + dt/2*k2;
    const Z k3 = flow(third, um);
    const Z k4 = flow(z + dt*k3, u1);
    z += dt/6*(k1 + 2*k2 + 2*k3 + k4);
    const N G = dt*jacobian(third, um);
    const N Phi = N::Identity() + G + G*G/2;
    S = (Phi*S*Phi.transpose()).eval();
    S.diagonal() += dt*Q;
    for (int j = 0; j < y1.size(); ++j) {
        const Eigen::Matrix<Z::Scalar, 1, Z::RowsAtCompileTime> c = slope(z, u1).row(j);
        const Z Pc = S*c.transpose();
        const Z K = Pc/(R[j]/dt + c.dot(Pc));
        z += K*(y1[j] - output(z, u1)[j]);
        S -= K*Pc.transpose();
    }
    (void)y0, (void)ym;""",
    "rk4_covariance": """
    const auto rate = [&](const Z &v, const N &V, const U &u, const Y &y, Z &dv, N &dV) {
        const N F = jacobian(v, u);
        const P H = slope(v, u);
        const Eigen::Matrix<Z::Scalar, Z::RowsAtCompileTime, Y::RowsAtCompileTime> PH = V*H.transpose();
        dv = flow(v, u) + PH*(y - output(v, u)).cwiseQuotient(R);
        const N FV = F*V;
        dV = FV + FV.transpose() - PH*R.cwiseInverse().asDiagonal()*PH.transpose();
        dV.diagonal() += Q;
    };
    Z k1, k2, k3, k4;
    N K1, K2, K3, K4;
    rate(z, S, u0, y0, k1, K1);
    rate(z + dt/2*k1, S + dt/2*K1, um, ym, k2, K2);
    rate(z + dt/2*k2, S + dt/2*K2, um, ym, k3, K3);
    rate(z + dt*k3, S + dt*K3, u1, y1, k4, K4);
    z += dt/6*(k1 + 2*k2 + 2*k3 + k4);
    S += dt/6*(K1 + 2*K2 + 2*K3 + K4);""",
}
PEERS: Mapping[str, Callable[[Case, str], Source]] = {
    "casadi": casadi,
    "symforce": symforce,
    "sympy": sympy,
    "eigen": eigen,
}


def source(peer: str, case: Case, real: str) -> Source:
    """The text of a peer. Raises: `Missing`."""
    if not case.method:
        raise Missing("no peer does the same")
    if case.n > LARGEST[peer]:
        raise Missing(f"{case.n} states take it minutes, or more memory than there is")
    return PEERS[peer](case, real)


def start(case: Case) -> list[float]:
    """w after the first row of the quiet record."""
    return [float(v) for v in mathematics.first(case, mathematics.model(case, math), case.quiet[0].tolist())]
