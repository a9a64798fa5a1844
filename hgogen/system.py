"""The plant: x' = flow(x, u; p), y = output(x, u; p), or x+ = flow(x, u; p), as the user writes it in SymPy."""

import math
from collections.abc import Iterable, Mapping, Sequence, Set
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import sympy as sp

from hgogen.analysis.manifold import invariant_fault
from hgogen.check import Check, Verdict
from hgogen.errors import BadArgument, nearest
from hgogen.reading import files
from hgogen.reading.expression import parse
from hgogen.registry import Displayed
from hgogen.rigor.box import End, box
from hgogen.rigor.invariant import factors, opposites
from hgogen.rigor.lookup import Cells, Stepped, Table
from hgogen.rigor.periodic import advance, exact_turn, with_exact_pi
from hgogen.rigor.recurrent import Aperiodic, Choose, divides, grouped, rewritten
from hgogen.rigor.shifts import Shifts, hidden_shifts
from hgogen.rigor.tape import NoTape, plain, tape
from hgogen.sentence import NONE, Reason, because
from hgogen.signal import Signal, Time, check_name, is_unit, part_of_turn, supplied, t, times


class BadSystem(BadArgument):
    """The error for a plant with an inconsistent declaration; its message names the part and a remedy."""

    text = "system {what!r}: {reason}"


class DiscretePlant(BadArgument):
    """The error for a discrete plant x+ = f(x, u), where a differential equation is required."""

    text = "system {what!r} is discrete in time, x+ = f(x, u): {reason}"


class BadValue(BadArgument):
    """The error for a value that a parameter cannot have."""


@dataclass(frozen=True)
class Origin:
    """The origin of a recast plant: the original `plant`, the new states as expressions of its states (`forward`), and
    its states as expressions of the new ones (`backward`)."""

    plant: "System"
    forward: tuple[sp.Expr, ...]
    backward: tuple[sp.Expr, ...]
    checks: tuple[Check, ...]


@dataclass(frozen=True)
class System(Displayed):
    """A plant, x' = flow(x, u; p), y = output(x, u; p); with `discrete`, x+ = flow(x, u; p).

    Args: `states` (n), `inputs` (m, may be empty), `outputs` (p), `parameters`: Signals; `flow` (n) and
    `output` (p): SymPy expressions of states, inputs and parameters. A parameter needs a nominal value. `time`: the
    unit of time, a plain word such as "min" or "h", in which the flow, every period and every trial is. `invariants`:
    expressions of states and parameters, or texts, that the flow keeps at 0, as q0**2 + .. + q3**2 - 1 of a quaternion.
    `discrete`: flow is the state at the next sample, from the state and the input at this one; `time` is then the unit
    of the sampling period alone.
    Flow and output may be periodic functions of the time `hg.t`; each of its periods becomes an input, a `Time`.

    Raises: `BadSystem` for lengths that do not match, unknown or repeated names, parameters without a value,
    a unit of time that is no word, a discrete plant with invariants or `rates` of a signal; `BadName` for a name that C
    could not carry; `BadFileName` for one that no file could.
    """

    name: str
    states: tuple[Signal, ...]
    inputs: tuple[Signal, ...]
    outputs: tuple[Signal, ...]
    parameters: tuple[Signal, ...]
    flow: tuple[sp.Expr, ...]
    output: tuple[sp.Expr, ...]
    origin: Origin | None
    time: str
    invariants: tuple[sp.Expr, ...]
    discrete: bool

    def __init__(
        self,
        name: str,
        *,
        states: Iterable[Signal],
        inputs: Iterable[Signal] = (),
        outputs: Iterable[Signal],
        parameters: Iterable[Signal] = (),
        flow: Sequence[Any],
        output: Sequence[Any],
        origin: Origin | None = None,
        time: str = "s",
        invariants: Sequence[Any] = (),
        discrete: bool = False,
    ) -> None:
        check_name(name)
        files.demand_file_name(name)
        groups = {"states": states, "inputs": inputs, "outputs": outputs, "parameters": parameters}
        fields: dict[str, Any] = {kind: _signals(name, kind, signals) for kind, signals in groups.items()}
        if not is_unit(time):
            raise BadSystem(name, f'time = {time!r} is no unit of time; write one plain word of letters, such as "h"')
        if not isinstance(discrete, bool):
            raise BadSystem(name, f"discrete = {discrete!r} must be True, for x+ = flow(x, u), or False, for x' = flow")
        fields |= {"name": name, "origin": origin, "time": str(time), "discrete": discrete}
        known = {s.name: s for kind in ("states", "parameters") for s in fields[kind]}
        fields |= {what: _expressions(name, what, rows) for what, rows in (("flow", flow), ("output", output))}
        fields["invariants"] = _expressions(name, "invariants", invariants, known)
        if any(s.period is not None for kind in groups for s in fields[kind]):  # of a float pi nothing is periodic
            fields |= {what: tuple(map(with_exact_pi, fields[what])) for what in ("flow", "output")}
        fields |= _timed(name, fields)
        for key, value in fields.items():
            object.__setattr__(self, key, value)
        _validate(self)

    @property
    def signals(self) -> tuple[Signal, ...]:
        """Every declared signal: states, inputs, outputs, parameters."""
        return self.states + self.inputs + self.outputs + self.parameters

    @property
    def next_mark(self) -> str:
        """The mark of a state on the left of its equation: "'", or "+" of a discrete plant."""
        return "+" if self.discrete else "'"

    @property
    def equations(self) -> tuple[str, ...]:
        """The equations as texts, x' = f(x, u) or x+ = f(x, u) of each state, then y = h(x, u) of each output."""
        mark = self.next_mark
        flow = (f"{x}{mark} = {row}" for x, row in zip(self.states, self.flow, strict=True))
        return (*flow, *(f"{y} = {row}" for y, row in zip(self.outputs, self.output, strict=True)))

    def __str__(self) -> str:
        return "\n".join([f"{self.name}, time in {self.time}", *(f"  {row}" for row in self.equations)])

    @property
    def supplied(self) -> tuple[Signal, ...]:
        """The inputs that a caller supplies: all but times, which follow them."""
        return supplied(self.inputs)

    @property
    def times(self) -> tuple[Time, ...]:
        """The inputs that are a `Time`, the last ones: flow and output are periodic functions of these."""
        return times(self.inputs)

    @property
    def tunable(self) -> tuple[Signal, ...]:
        """The parameters with a range, which may be set while a program runs."""
        return tuple(p for p in self.parameters if p.bounded)

    @property
    def tables(self) -> tuple[Cells, ...]:
        """The tables that the flow and the output read, by name, each once and constant beyond its ends."""
        rows = (*self.flow, *self.output)
        read = {node.cells.name: node.cells.clamping() for row in rows for node in row.atoms(Table)}
        return tuple(read[name] for name in sorted(read))

    @property
    def declared(self) -> "System":
        """The plant as first declared: the plant itself, or for a recast plant the original one."""
        return self if self.origin is None else self.origin.plant

    @property
    def reported(self) -> tuple[tuple[Signal, sp.Expr], ...]:
        """The reported estimates: each state of the plant as first declared, as an expression of this plant's
        states."""
        if self.origin is None:
            return tuple((s, s) for s in self.states)
        return tuple(zip(self.origin.plant.states, self.origin.backward, strict=True))

    @property
    def checks(self) -> tuple[Check, ...]:
        """The claims about a recast plant: its coordinates are coordinates, and in their ranges."""
        return () if self.origin is None else self.origin.checks

    @property
    def caveat(self) -> Reason:
        """Why a proof about a recast plant may not hold for the plant as first declared, or `NONE`."""
        unproved = [check.id for check in self.checks if check.verdict is not Verdict.PROVED]
        return because("{claims: and } of the new states is not proved", claims=unproved) if unproved else NONE

    @property
    def box(self) -> dict[sp.Symbol, tuple[End, End]]:
        """The box of all signals. Without a range, a parameter is at its value, and another signal is unbounded."""
        return box(self.signals, self.nominal)

    def box_with(self, states: Iterable[Signal]) -> dict[sp.Symbol, tuple[End, End]]:
        """Return the box of `states`, the plant's inputs and parameters; parameters without a range are at their
        values."""
        return box((*states, *self.inputs, *self.parameters), self.nominal)

    @property
    def wraps(self) -> str:
        """The reason why an observer's error does not follow its differential equation alone: an output is an angle,
        which is corrected the short way round, or the estimate is projected onto invariants; "" for neither."""
        angles = [y.name for y in self.outputs if y.period is not None]
        if angles:
            return f"the error of {' and '.join(angles)} is taken the short way round, which no proof here covers"
        return "the estimate is projected onto invariants, which no proof here covers" if self.invariants else ""

    @cached_property
    def modulo(self) -> str:
        """The states that the outputs determine only modulo a part of a turn, as an encoder with four pole pairs does,
        or modulo a common shift, as text: "th modulo a quarter turn"; "" if there are none, and for a plant without
        periods."""
        if all(s.period is None for s in (*self.states, *self.outputs)):
            return ""
        shifts = self._shifts

        def admitted(shift: Mapping[Signal, sp.Expr]) -> bool:
            inside = (abs(step) <= x.interval[1] - x.interval[0] for x, step in shift.items() if x.period is None)
            return all(inside)

        parts = [f"{x} modulo {part_of_turn(x, step)}" for x, step in shifts.single.items() if admitted({x: step})]
        for joint in filter(admitted, shifts.joint):
            each = (f"{part_of_turn(x, shift)} of {x}" for x, shift in joint.items())
            parts.append(f"{' and '.join(map(str, joint))} modulo a joint shift by {' and '.join(each)}")
        parts += [f"{x} up to shifts that are not excluded" for x in shifts.open]
        return ", ".join(parts)

    @cached_property
    def growing(self) -> dict[Signal, sp.Expr]:
        """The states without range and period that only sines and cosines read, each with the period of these: such a
        state grows with each turn, and as a float it loses its digits."""
        free = {x for x in self.states if x.period is None and not x.bounded}
        waves = sp.Tuple(*self.flow, *self.output).atoms(sp.sin, sp.cos) if free else set()
        if not any(free & wave.free_symbols for wave in waves):
            return {}
        return {x: step for x, step in self._shifts.single.items() if x in free}

    @cached_property
    def _shifts(self) -> Shifts:
        output, flow, invariants = (
            [row.xreplace(self.constants) for row in each] for each in (self.output, self.flow, self.invariants)
        )
        rows = [(row, y.period) for y, row in zip(self.outputs, output, strict=True)]
        rows += [(row, None) for row in (*invariants, *(() if self.discrete else flow))]
        # those without a period first: a basis then has the least shifts of these, which their ranges may not admit
        pairs = sorted(zip(self.states, flow, strict=True), key=lambda pair: pair[0].period is not None)
        following = [row for _, row in pairs] if self.discrete else ()
        return hidden_shifts({x: x.period for x, _ in pairs}, rows, following)

    @cached_property
    def constraints(self) -> tuple[sp.Expr, ...]:
        """The invariants without denominators and factors that are not 0: x of p x or x/y, with the same zeros."""
        return tuple(row for c in self.invariants for row, _ in factors(c, self.states, self.box))

    @cached_property
    def opposites(self) -> tuple[tuple[int, ...], ...]:
        """The sets of states in invariants, by index, that may change sign together without another attitude, as q and
        -q of a quaternion."""
        return opposites(self.invariants, dict(zip(self.states, self.flow, strict=True)), self.output)

    @property
    def constants(self) -> dict[Signal, sp.Rational]:
        """The parameters without a range, with their values."""
        return {p: value for p, value in self.nominal.items() if not p.bounded}

    @property
    def nominal(self) -> dict[Signal, sp.Rational]:
        """The nominal value of each parameter, as the exact rational of its shortest decimal."""
        return {p: sp.Rational(str(p.nominal)) for p in self.parameters}


def demand_continuous(plant: System, what: str, take: str = "") -> None:
    """Raise `DiscretePlant` for a discrete plant; `what`: the name of the function that requires a differential
    equation, `take`: the end of the message, a remedy."""
    if plant.discrete:
        raise DiscretePlant(plant.name, f"{what} is for differential equations, x' = f(x, u){take}")


def _signals(system: str, kind: str, signals: Iterable[Signal]) -> tuple[Signal, ...]:
    if isinstance(signals, Signal):
        raise BadSystem(system, f"{kind} is a single Signal; write a tuple, {kind}=({signals.name},)")
    if isinstance(signals, Set) or not isinstance(signals, Iterable):
        raise BadSystem(system, f"{kind} is {signals!r}; write a tuple of Signals, whose order counts")
    signals = tuple(signals)
    for signal in signals:
        if not isinstance(signal, Signal):
            raise BadSystem(system, f"{kind} holds {signal!r}, which is no Signal; declare it with hg.Signal")
    return signals


def _expressions(
    system: str, what: str, values: Sequence[Any], texts: Mapping[str, Signal] | None = None
) -> tuple[sp.Expr, ...]:
    """Return the rows of a plant; `texts`: the signals that a row may name as text, None where it may not be text."""
    if isinstance(values, sp.MatrixBase):
        values = list(values)
    if isinstance(values, sp.Basic | str | Mapping | Set) or not isinstance(values, Iterable):
        raise BadSystem(system, f"{what} is {values!r}; write a list of expressions in the signals' order")
    result = []
    for index, value in enumerate(values, 1):
        try:
            expression = parse(value, texts) if texts and isinstance(value, str) else sp.sympify(value, strict=True)
        except (sp.SympifyError, TypeError):
            raise BadSystem(system, f"{what} {index} is {value!r}, not a SymPy expression or number") from None
        if not isinstance(expression, sp.Expr) or expression.is_Matrix:
            raise BadSystem(system, f"{what} {index} is {expression}, which is not a scalar expression")
        roots = (e for e in expression.atoms(sp.Pow) if e.base.is_negative and e.exp.is_integer is not True)
        if expression.has(sp.nan, sp.zoo, sp.oo, -sp.oo, sp.I) or expression.is_real is False or any(roots):
            raise BadSystem(system, f"{what} {index}, {expression}, is not finite and real; correct it")
        result.append(plain(expression))
    return tuple(result)


def _timed(name: str, fields: Mapping[str, Any]) -> Mapping[str, Any]:
    """Return the rows of a plant with t replaced by times modulo its periods, and the inputs with these times.

    Raises: `BadSystem`."""
    rows, known = {kind: fields[kind] for kind in ("flow", "output")}, times(fields["inputs"])
    every = (s for kind in ("states", "inputs", "outputs", "parameters") for s in fields[kind])
    used_names = {s.name for s in every if s not in known}
    read = set[sp.Symbol]().union(*(row.free_symbols for each in rows.values() for row in each))
    bare = {s: t for s in read - {*known} if s.name == t.name and t.name not in used_names}
    values = {p: sp.Rational(str(p.nominal)) for p in fields["parameters"] if p.nominal is not None and not p.bounded}
    if not bare and all(_counted(w, row, values) for w in known for each in rows.values() for row in each):
        return {"inputs": (*supplied(fields["inputs"]), *known)} if known else {}
    if fields["discrete"]:
        raise BadSystem(name, "is discrete and reads t; give its values at the samples as an input")
    bare |= dict.fromkeys(known, t)
    rows = {kind: [row.xreplace(bare) for row in each] for kind, each in rows.items()}
    turns = list[sp.Expr]()
    _periodic_rows(name, rows, values, _recording(turns, t))
    groups = grouped(turns)
    names = ["t"] * (len(groups) == 1 and "t" not in used_names)
    names += [one for k in range(1, len(groups) + len(used_names) + 1) if (one := f"t_{k}") not in used_names]
    each = {turn: Time(one, turn, fields["time"]) for one, turn in zip(names, groups, strict=False)}
    inputs = (*supplied(fields["inputs"]), *each.values())

    def within(turn: sp.Expr) -> sp.Symbol:
        return next(time for whole, time in each.items() if divides(turn, whole))

    return {"inputs": inputs, **_periodic_rows(name, rows, values, within)}


def _periodic_rows(
    name: str, rows: Mapping[str, Sequence[sp.Expr]], values: Mapping[sp.Symbol, sp.Expr], choose: Choose
) -> dict[str, tuple[sp.Expr, ...]]:
    """Return rows with t replaced by the symbols that `choose` returns for their periods. Raises: `BadSystem`."""
    result = dict[str, list[sp.Expr]]((kind, []) for kind in rows)
    for kind, each in rows.items():
        for k, row in enumerate(each, 1):
            try:
                result[kind].append(rewritten(row, t, values, choose))
            except Aperiodic as error:
                way = "write it with sin, cos or Mod of t and constants, or give its values as an input"
                raise BadSystem(name, f"{kind} {k}: {error}; {way}") from None
    return {kind: tuple(map(plain, each)) for kind, each in result.items()}


def _recording(turns: list[sp.Expr], time: sp.Symbol) -> Choose:
    """Return a function that chooses the symbol `time` for each period, and appends the period to `turns`."""

    def recorded(turn: sp.Expr) -> sp.Symbol:
        turns.append(turn)
        return time

    return recorded


def _counted(time: Time, row: sp.Expr, values: Mapping[sp.Symbol, sp.Expr]) -> bool:
    """Return whether the turn of `time` is a whole multiple of every period of a row, for the present parameter
    values."""
    turns = list[sp.Expr]()
    with suppress(Aperiodic):  # a form's row, in which sums are expanded
        rewritten(row, time, values, _recording(turns, time))
    return all(divides(turn, time.turn) for turn in turns)


def _validate(system: System) -> None:
    _validate_counts(system)
    by_name: dict[str, Signal] = {}
    for signal in system.signals:
        if signal.name in by_name:
            raise BadSystem(system.name, f"the name {signal.name!r} is declared twice; rename one of the two")
        by_name[signal.name] = signal
    flow, output = (list(enumerate(rows, 1)) for rows in (system.flow, system.output))
    places = {**{f"flow {k}": row for k, row in flow}, **{f"output {k}": row for k, row in output}}
    places |= {f"invariant {k}": row for k, row in enumerate(system.invariants, 1)}
    _validate_tables(system, by_name, places)
    for parameter in system.parameters:
        if parameter.nominal is None or not math.isfinite(parameter.nominal):
            raise BadSystem(system.name, f"parameter {parameter.name!r} has no value; give it nominal=")
    _validate_periods(system, places)
    _validate_symbols(system, by_name, places)
    if system.discrete:
        _validate_discrete(system)
    _validate_invariants(system)


def _validate_counts(system: System) -> None:
    for kind in ("states", "outputs"):
        if not getattr(system, kind):
            raise BadSystem(system.name, f"has no {kind}; an observer needs at least one")
    for kind, values in (("states", "flow"), ("outputs", "output")):
        want, have = len(getattr(system, kind)), len(getattr(system, values))
        if want != have:
            raise BadSystem(system.name, f"has {want} {kind} but {have} expressions in {values}; give one for each")


def _validate_symbols(system: System, by_name: Mapping[str, Signal], places: Mapping[str, sp.Expr]) -> None:
    allowed = set(system.states + system.inputs + system.parameters)
    for place, row in places.items():
        for symbol in sorted(row.free_symbols - allowed, key=str):
            raise BadSystem(system.name, f"{place} uses {_stranger(symbol, by_name, system)}")
        try:
            tape([row], row.free_symbols)
        except NoTape as error:
            raise BadSystem(system.name, f"{place}, {error}") from None


def _validate_discrete(system: System) -> None:
    if system.invariants:
        raise BadSystem(
            system.name, "is discrete and has invariants, which are for differential equations; leave them out"
        )
    for signal in system.signals:
        if signal.rates:
            reason = f"is discrete, and {signal.name} has rates, the ranges of derivatives; leave them out"
            raise BadSystem(system.name, reason)


def _validate_tables(system: System, by_name: Mapping[str, Signal], places: Mapping[str, sp.Expr]) -> None:
    tables = {node.cells for row in places.values() for node in row.atoms(Table)}
    named: dict[str, Cells] = {}
    for cells in sorted(tables, key=lambda each: each.name):
        if cells.name in by_name:
            raise BadSystem(system.name, f"a signal and a table are called {cells.name!r}; rename one of the two")
        if named.setdefault(cells.name, cells).points != cells.points:
            raise BadSystem(
                system.name, f'two tables are called {cells.name!r}; give each a name, name="{cells.name}_2"'
            )
    for place, row in places.items():  # at a jump of a slope a program has one of its values, a proof all
        for node in sorted(row.atoms(Stepped), key=str):
            fix = "write what it stands for as a table of its own"
            raise BadSystem(system.name, f"{place} has {node}, which jumps at its points; {fix}")


def _validate_periods(system: System, places: Mapping[str, sp.Expr]) -> None:
    """Raise `BadSystem` unless the plant is periodic in each state that is declared periodic: after a turn the flow
    must be equal, and an output, or the next value of a discrete plant's state, equal or changed by whole periods of
    its own."""
    for parameter in system.parameters:
        if parameter.period is not None:
            raise BadSystem(
                system.name, f"parameter {parameter.name!r} has a period, which is for signals; leave it out"
            )
    own = {f"output {k}": y.period for k, y in enumerate(system.outputs, 1)}
    own |= {f"flow {k}": x.period for k, x in enumerate(system.states, 1) if system.discrete}
    signals = [s for s in (*system.states, *system.inputs) if s.period is not None]
    constants = system.constants if signals else {}
    for signal in signals:
        for place, row in places.items():
            change, own_period = advance(row.xreplace(constants), signal, exact_turn(signal.period)), own.get(place)
            turns = change if own_period is None else change / exact_turn(own_period)
            if not (turns.is_zero if own_period is None else turns.is_Integer):
                raise BadSystem(system.name, _aperiodic(place, signal, change, own_period))


def _validate_invariants(system: System) -> None:
    """Raise `BadSystem` for as many invariants as states, an invariant with an input, and a fault that `manifold.fault`
    finds."""
    k, n = len(system.invariants), len(system.states)
    if k >= n:
        reason = f"has {k} invariants of {n} states, which leave nothing to estimate"
        raise BadSystem(system.name, f"{reason}; leave out those that follow from others")
    for k, row in enumerate(system.invariants, 1):
        for symbol in sorted(row.free_symbols - {*system.states, *system.parameters}, key=str):
            raise BadSystem(system.name, f"invariant {k} uses the input {symbol}; write it in states and parameters")
    around = tuple(system.nominal.items())
    if system.invariants and (
        reason := invariant_fault(system.invariants, system.states, system.inputs, around, system.flow)
    ):
        raise BadSystem(system.name, reason)


def _aperiodic(place: str, signal: Signal, change: sp.Expr, period: float | None) -> str:
    over = f"{place} changes by {change} over one turn of {signal.name} (period {signal.period:g})"
    if place.startswith("output") and change.is_number and period is None:
        return f"{over}; declare the output with period = {abs(float(change)):g} or a fraction of it"
    if period is not None and change.is_number:
        whose = "output" if place.startswith("output") else "state"
        return f"{over}, which is no multiple of the {whose}'s own, {period:g}; correct one of the two"
    turn = exact_turn(signal.period)
    if turn != 2 * sp.pi and abs(float(turn) / (2 * math.pi) - 1) < 1e-3:
        return f"{over}; a turn in radians is 2*pi: declare period = 2*pi of {signal.name}"
    if change.has(sp.sin, sp.cos, sp.tan) and not turn.has(sp.pi):
        return f"{over}; sines and cosines are of radians: write {2 * sp.pi * signal / turn} in them"
    return f"{over}; write {signal.name} in sines and cosines, or leave out its period"


def _stranger(symbol: sp.Symbol, by_name: Mapping[str, Signal], system: System) -> str:
    if symbol in system.outputs:
        return f"the output {symbol}; write it in states and inputs"
    if symbol.name in by_name:
        return f"a symbol {symbol} that is not the Signal declared with that name; use the Signal itself"
    return f"the unknown symbol {symbol}; declare it as a Signal among states, inputs or parameters"


def valued(plant: System, values: Mapping[str, float]) -> System:
    """Return the plant with other nominal values of parameters, by name. Raises: `BadValue` for a name that is no
    parameter, a value outside of its range, and a plant that is recast."""
    new = exchanged(plant, values)
    groups = (plant.flow, plant.output, plant.invariants)
    flow, output, invariants = (tuple(row.xreplace(new) for row in rows) for rows in groups)
    parameters = tuple(new.get(p, p) for p in plant.parameters)
    return replace(plant, parameters=parameters, flow=flow, output=output, invariants=invariants)


def exchanged(plant: System, values: Mapping[str, float]) -> dict[Signal, Signal]:
    """Return a mapping from each parameter named in `values` to a copy with the new value. Raises: `BadValue`."""
    if plant.origin is not None:
        raise BadValue(f"plant {plant.name!r}", "is recast; give the values to the plant that it was recast from")
    known = {p.name: p for p in plant.parameters}
    for name in values:
        if name not in known:
            listed = f"its parameters are {', '.join(known)}" if known else "it has no parameters"
            raise BadValue(f"{name[:60]!r}", f"is no parameter of {plant.name!r}; {nearest(name, known, listed)}")
    new = {}
    for name, value in values.items():
        p = known[name]
        low, high = p.interval
        if not low <= value <= high:
            raise BadValue(f"{p.name} = {value:g}", f"lies outside of its range [{low:g}, {high:g}]; widen that")
        new[p] = Signal(p.name, p.unit, p.meaning, value, p.low, p.high, p.rates, p.period)
    return new
