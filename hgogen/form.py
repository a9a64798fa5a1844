"""A form: the plant in observer coordinates, z' = A(u) z + b(z, u), y = h(z, u), each claim a `Check`. For a discrete
plant the left side is z+, the coordinates at the next sample.

Every observer treats the two parts differently. The linear part A(u) z is used as it is. The nonlinear part b takes its
argument clamped to the declared box, because a proof about the plant holds on the box and the estimate leaves it while
it peaks.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, wraps
from typing import Annotated, Any, TypeVar, cast

import sympy as sp

from hgogen.analysis.undefined import MAKER, undefined_values
from hgogen.check import Check, Verdict
from hgogen.errors import BadArgument
from hgogen.registry import Displayed, display
from hgogen.rigor.box import End
from hgogen.rigor.periodic import advance, exact_turn
from hgogen.sentence import Sentence, equations
from hgogen.signal import Signal
from hgogen.system import System

Make = TypeVar("Make", bound=Callable[..., Any])


class NoForm(BadArgument):
    """The error for a plant to which a form does not apply."""

    text = "system {what!r} {reason}"


class OneOutput(NoForm):
    """The error for a plant with several outputs, where a form requires exactly one."""


def one_output(plant: System, advice: str, error: type[NoForm] = OneOutput) -> None:
    """Raise `error` unless the plant has exactly one output; `advice`: the end of the error's message, a remedy."""
    if len(plant.outputs) != 1:
        names = ", ".join(y.name for y in plant.outputs)
        raise error(plant.name, f"has {len(plant.outputs)} outputs, {names}{advice}")


@dataclass(frozen=True)
class SurveySettings:
    """The settings by which the survey of all forms (`hgogen.which_forms`) tries one form.

    `place`: its order among the forms, the narrowest first; `options`: the arguments of each variant of the form;
    `least` and `most`: the numbers of outputs that it applies to (0: any number); `costly`: whether the attempt takes
    seconds; `slow`: whether building an observer on it does; `candidate`: whether it may be the best form, which a form
    without a claim of observability may not; `discrete`: whether it is a form of discrete plants too.
    """

    place: int = 100
    options: tuple[Mapping[str, Any], ...] = ({},)
    least: int = 1
    most: int = 0
    costly: bool = False
    slow: bool = False
    candidate: bool = True
    discrete: bool = False

    def refusal(self, outputs: int) -> str:
        """Return why the form is not tried for a plant with this number of outputs, "" if it is."""
        if outputs < self.least:
            return f"for {self.least} outputs or more"
        return f"for {self.most} output{'s' * (self.most > 1)}" if 0 < self.most < outputs else ""

    def __call__(self, form: Make) -> Make:
        """Attach the settings to `form`, a function of `hg.forms`, as a decorator, and return it."""
        vars(form)["survey_settings"] = self
        return form


@dataclass(frozen=True)
class Form(Displayed):
    """The plant in an observability form, proved or not.

    `states`: n Signals z_1..z_n with the ranges of the plant's states; `to_form`: z as expressions of the plant's
    states; `from_form`: the plant's states as expressions of z; `A`: n x n, of inputs and parameters (and z_1, where
    the form says so); `b`: n expressions of z, inputs, parameters; `output`: p expressions of z, inputs, parameters;
    `checks`: one for each hypothesis.

    `blocks`: the number of states of each output's chain, in the order of z, 0 for an output without one, by default
    one block of n; `alignment`: how blocks may read each other, "" for one; `levels`: the distance from the outputs of
    each state that is in no such chain, 0 for the first, by default its place.

    `jacobian`: n x n, of z, inputs and parameters, of a map to phase coordinates in which a gain acts through its
    inverse; None where z are the coordinates of the gain. `behind`: b as expressions of the plant's states, where b as
    a function of z may have poles in the box of z, or is too large there. An observer evaluates it at from_form(z),
    with denominators of the sign that they have on the image of the plant's ranges, clamped to these ranges.

    `clamped`: whether an observer clamps these arguments, as its proofs assume; `limits`: the range to which an
    observer limits the value of each row of b, () without; `free`: whether the argument of such a row is not clamped;
    `fallback`: the names of accepted rows without a finite value somewhere, for which an observer keeps the last valid
    value (`analysis.dynamics`).
    """

    system: System
    kind: Annotated[str, "name of the form"]
    states: tuple[Signal, ...]
    to_form: tuple[sp.Expr, ...]
    from_form: tuple[sp.Expr, ...]
    A: sp.ImmutableDenseMatrix
    b: tuple[sp.Expr, ...]
    output: tuple[sp.Expr, ...]
    checks: tuple[Check, ...]
    reference: str
    blocks: tuple[int, ...] = ()
    alignment: str = ""
    levels: tuple[int, ...] = ()
    jacobian: sp.ImmutableDenseMatrix | None = None
    behind: tuple[sp.Expr, ...] | None = None
    clamped: bool = True
    limits: tuple[tuple[float, float], ...] = ()
    free: bool = False
    fallback: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        """Set the defaults: one block of all n states, and the level of each state equal to its position."""
        if not self.blocks:
            object.__setattr__(self, "blocks", (self.n,))
        if not self.levels:
            object.__setattr__(self, "levels", tuple(range(self.n)))

    @property
    def n(self) -> int:
        """Number of states."""
        return len(self.states)

    @property
    def box(self) -> dict[sp.Symbol, tuple[End, End]]:
        """The box of z, the inputs and the parameters; a parameter without a range has its value as both ends."""
        return self.system.box_with(self.states)

    @property
    def names(self) -> tuple[str, ...]:
        """The names of z_1..z_n in a gain: the name of the plant's state x where z_i is x or -x, else the name of
        z_i."""
        states = {sign * x: x.name for x in self.system.states for sign in (1, -1)}
        return tuple(str(states.get(e, z.name)) for z, e in zip(self.states, self.to_form, strict=True))

    @property
    def signs(self) -> tuple[int, ...]:
        """The signs of z_1..z_n: -1 where z_i = -x for a state x of the plant, else 1."""
        return tuple(-1 if -e in self.system.states else 1 for e in self.to_form)

    @property
    def heads(self) -> tuple[int, ...]:
        """The index in z at which the chain of each block begins."""
        return tuple(sum(self.blocks[:i]) for i in range(len(self.blocks)))

    @property
    def leads(self) -> tuple[int, ...]:
        """The numbers of the outputs that have a chain of states."""
        return tuple(k for k, size in enumerate(self.blocks) if size)

    @property
    def gains(self) -> tuple[tuple[sp.Expr, ...], ...]:
        """The gains a_(i,1), .., a_(i,n_i) of each output's chain, whatever they depend on."""
        chains = zip(self.output, self.heads, self.blocks, strict=True)
        return tuple(
            (sp.diff(y, self.states[head]), *(self.A[i, i + 1] for i in range(head, head + size - 1))) if size else ()
            for y, head, size in chains
        )

    @property
    def gain_names(self) -> tuple[tuple[str, ...], ...]:
        """The names of the gains: a_1, a_2, .. for one chain; a_(1,1), a_(1,2), .. for several chains."""
        name = "a_({},{})" if len(self.blocks) > 1 else "a_{1}"
        return tuple(tuple(name.format(i, j) for j in range(1, size + 1)) for i, size in enumerate(self.blocks, 1))

    @property
    def structured(self) -> bool:
        """Whether the plant is proved to have the form's structure; without it, its states keep the plant's order."""
        return all(check.verdict is Verdict.PROVED for check in self.about("structure"))

    def about(self, fact: str) -> tuple[Check, ...]:
        """Return the checks whose `ClaimId.fact` is `fact`, such as "rank", without those of an equation with that
        name."""
        return tuple(check for check in self.checks if check.id.fact == fact and check.id.maker != MAKER)

    @cached_property
    def estimates(self) -> tuple[tuple[Signal, sp.Expr], ...]:
        """The reported estimates: each state of the plant as first declared, in terms of z."""
        back = dict(zip(self.system.states, self.from_form, strict=True))
        return tuple((signal, expression.subs(back)) for signal, expression in self.system.reported)

    @property
    def entry(self) -> tuple[sp.Expr, ...]:
        """The map from the reported states to the coordinates z, the inverse of `estimates`."""
        origin = self.system.origin
        if origin is None:
            return self.to_form
        forward = dict(zip(self.system.states, origin.forward, strict=True))
        return tuple(expression.subs(forward) for expression in self.to_form)

    @property
    def flow(self) -> tuple[sp.Expr, ...]:
        """The rates z' = A(u) z + b(z, u)."""
        linear = self.A * sp.Matrix(self.states)
        return tuple(row + nonlinear for row, nonlinear in zip(linear, self.b, strict=True))

    @property
    def nonlinear(self) -> tuple[sp.Expr, ...]:
        """The nonlinear part (n) of z': b, and the terms of A z whose coefficient depends on a state."""
        known = {*self.states}
        terms = (
            (a * z if a.free_symbols & known else sp.S.Zero for a, z in zip(self.A.row(i), self.states, strict=True))
            for i in range(self.n)
        )
        return tuple(sp.Add(b, *row) for b, row in zip(self.b, terms, strict=True))

    @property
    def head(self) -> tuple[Sentence, ...]:
        """A title with the coordinates, and the equations, line by line."""
        change = equations(dict(zip(self.states, self.to_form, strict=True)))
        title = "{plant} in {kind} form, {change}" if self.structured else "{plant} not shown in {kind} form, {change}"
        flow, output = (zip(self.states, self.flow, strict=True), zip(self.system.outputs, self.output, strict=True))
        return (
            Sentence.of(title, plant=self.system.name, kind=self.kind, change=change),
            *(Sentence.of("  {z}{mark} = {rate}", z=z, mark=self.system.next_mark, rate=rate) for z, rate in flow),
            *(Sentence.of("  {y} = {value}", y=y, value=value) for y, value in output),
        )

    def plot_observability(self, trial: Any = None) -> Sequence[Any]:
        """Return the matplotlib axes of a figure of the plant's observability measure: the least observable direction
        by state, along a trial (`hgogen.trial.Trial`), or at fixed points of the declared ranges.

        Raises: `NoLinearisation` where a state has no range; `BadTrial`; `NoGraph`."""
        axes: Sequence[Any] = display("observability_plot")(self.system.declared, trial)
        return axes

    def __str__(self) -> str:
        return "\n".join([*map(str, self.head), *(f"  {check}" for check in self.checks)])


def _demand_turns(form: Form) -> None:
    """Raise `NoForm` if a full turn of a periodic state changes a coordinate z_i other than plus or minus this
    state."""
    for state, period in ((each, each.period) for each in form.system.states):
        for z, e in zip(form.states, form.to_form, strict=True):
            turns = period is not None and e not in (state, -state)
            if turns and not advance(e, state, exact_turn(period)).is_zero:
                reason = f"has the periodic state {state.name}, and a turn of it changes the coordinate {z} = {e}"
                raise NoForm(form.system.name, f"{reason}; use hg.forms.original, or sines and cosines of {state.name}")


def valued(make: Make) -> Make:
    """Return the form function `make`, changed: the `checks` of its forms begin with `singular.NAME` for each equation
    that may have no finite value on the declared box. The new function raises `NoForm` for a coordinate that changes
    with a full turn of a periodic state."""

    @wraps(make)
    def make_valued(*args: Any, **options: Any) -> Form:
        form: Form = make(*args, **options)
        _demand_turns(form)
        known = {check.id for check in form.checks}
        new = tuple(check for check in undefined_values(form.system) if check.id not in known)
        return replace(form, checks=(*new, *form.checks)) if new else form

    return cast(Make, make_valued)
