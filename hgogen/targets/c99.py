"""C99 for firmware: NAME.h, NAME.c, NAME_check.c with recorded vectors, and the manual NAME.md.

Caller-owned structs, no heap, no static data that changes, no recursion, bounded loops; every call returns a status, a
bit mask with 0 for ok. Compile with `-ffp-contract=off` for the same bits on every IEEE 754 target whose
FLT_EVAL_METHOD is 0.
"""

from collections.abc import Iterable, Iterator
from dataclasses import replace

from hgogen.emit.code import Code, Uses, braced, code, joined, spaced
from hgogen.emit.document import document, manual
from hgogen.emit.heads import header
from hgogen.emit.interface import Prototype, entries, inside, nominal, of_section, prototypes, readied, same_name
from hgogen.emit.manual import document_name
from hgogen.emit.naming import demand_distinct, demand_file, sources
from hgogen.emit.portable import c_functions, includes, kernels, tables
from hgogen.emit.printer import LEAST, NEVER
from hgogen.emit.saved import saving
from hgogen.emit.selfcheck import c_check
from hgogen.emit.sharing import SharingWriter
from hgogen.emit.statements import called, reading, routines
from hgogen.emit.syntax import Real, demand_real
from hgogen.emit.syntaxes import C, vectors
from hgogen.program import Field, Group, Place
from hgogen.reading.given import demand_switch
from hgogen.step import Step, demand_step
from hgogen.stepping.discretise import demand_motion
from hgogen.stepping.guards import NO_PARAMETERS, UNINITIALISED
from hgogen.stepping.times import T
from hgogen.target import Sources


def c99(step: Step, *, real: Real = "float", command: str = "", check: bool = True) -> Sources:
    """Return the step as C99 text, by file name: header, source, self-check and manual.

    Args: `real` "float" or "double"; `command` what made it, for the banner; `check` whether to add the
    self-check, whose vectors take a while to compute.

    Raises: `NoStep`, `BadReal`; `StepTooShort` where a state stands still in that precision; `HidesHeader`, `OneName`
    for names that C cannot carry; `BeyondFloat`, `NotPrintable` for a number, an operation that has no text;
    `PointsMerge` for a table.
    """
    demand_step(step, "c99")
    demand_switch("c99, check=", check)
    demand_real(real)
    demand_motion(step.observer.form, step.shortest, real)
    demand_file(step.name)
    demand_distinct(step, C)
    files = {f"{step.name}.h": header(step, real, command), f"{step.name}.c": _source(step, real)}
    files |= {f"{step.name}_check.c": c_check(step, real)} if check else {}
    emitted = sources(step, C, files)
    text = "\n".join(document(step, manual(step, real, check))).rstrip("\n") + "\n"
    return replace(emitted, texts=(*emitted.texts, (document_name(step), text)))


_HEADERS = {"bool": "stdbool.h"}  # where C99 declares a type
_HEADERS |= dict.fromkeys(("int32_t", "int64_t", "uint32_t", "uint64_t"), "stdint.h")
_IEEE = (
    "#if defined(__FAST_MATH__) || (defined(__FINITE_MATH_ONLY__) && (__FINITE_MATH_ONLY__ > 0))",
    '#error "needs IEEE 754 comparisons: -ffast-math drops the guards against what is not a number"',
    "#endif",
    "#if defined(__ASSOCIATIVE_MATH__)",
    '#error "needs sums in their order: -funsafe-math-optimizations spoils the bundled functions"',
    "#endif",
    "",
)
_RARELY = (
    "/* for a function that runs rarely: it is not inlined */",
    "#if defined(__GNUC__)",
    "#define {upper}_RARELY __attribute__((noinline))",
    "#else",
    "#define {upper}_RARELY",
    "#endif",
    "",
)


def _source(step: Step, real: Real) -> list[str]:
    name, writer = step.name, SharingWriter(C, step, real)
    interface = spaced(_functions(writer))
    interface = routines(writer, interface.uses.routines) + interface
    helpers, matrices = interface.uses.helpers, interface.uses.kernels
    syntax, macros = vectors(name, real, matrices)
    shared = c_functions(syntax, name, real, helpers) + tables(C, name, real, interface.uses.lookups)
    text = shared + kernels(C, name, real, matrices) + interface
    return [
        f"/* {name}: see {name}.h, and its manual {document_name(step)}. */",
        f'#include "{name}.h"',
        "",
        *_includes(step, includes(name, real, helpers), text.uses),
        *_IEEE,
        *(line.format(upper=name.upper()) for line in _RARELY),
        *macros,
        *text.lines,
    ]


def _functions(writer: SharingWriter) -> Iterator[Code]:
    step, declared = writer.step, prototypes(writer.step)
    rarely = f"{step.name.upper()}_RARELY"
    if step.layout.mark:
        yield _readied(step, step.layout.mark, rarely)
    for part in writer.parts:
        yield _function(part.prototype, part.body, rarely)
    for section in (*step.code.inner, *step.code.parts):
        functions, body = writer.section(section)
        yield from functions
        yield _function(inside(step, section), body)
    yield _function(nominal(step), _nominal(step, writer.real), rarely)
    changing = (each for each in entries(step).values() if each.public and each.status and "s" in each.written)
    checking = {each.name for each in changing} if step.layout.mark else set[str]()
    bodies, functions = _bodies(writer)
    yield from functions
    for name, body in bodies.items():
        text = _checking(step, declared[name], body) if name in checking else _function(declared[name], body)
        yield code(rarely) + text if name == "reset" else text
    yield saving(step, writer.real)


def _checking(step: Step, prototype: Prototype, body: Code) -> Code:
    upper, test = step.name.upper(), "({}->ready != {}_READY)"
    missing = braced(
        f"if ({' || '.join(test.format(name, upper) for name in 'sp')}) {{",
        code(f"status = {readied(step).call(same_name)};", parameters="sp"),
    )
    return _function(prototype, missing + braced(f"if ((status & {upper}_{NO_PARAMETERS.name}) == 0u) {{", body))


def _readied(step: Step, mark: Field, rarely: str) -> Code:
    upper = step.name.upper()
    reset = prototypes(step)["reset"].call(lambda each: "0" if each.name == T.name else each.name)
    lines = [
        (f"if ({name}->{mark.name} != {upper}_READY) {{", f"    {reset};", f"    status |= {upper}_{bit.name};", "}")
        for name, bit in (("s", UNINITIALISED), ("p", NO_PARAMETERS))
    ]
    return _function(readied(step), code(*lines[0], *lines[1], parameters="sp"), rarely)


def _bodies(writer: SharingWriter) -> tuple[dict[str, Code], list[Code]]:
    step, functions = writer.step, list[Code]()
    inner = (section for section in step.code.sections if of_section(step, section).inner)
    bodies = {section.name: called(C, step, section) for section in inner}
    if step.code.parts:
        bodies["step"] = joined(called(C, step, section) for section in step.code.parts)
    else:
        functions, bodies["step"] = writer.section(step.code.sections[0])
    bodies |= {section.name: writer.function(section.program) for section in step.code.timed}
    bodies["estimate"] = writer.function(step.code.estimate)
    bodies |= {report.name: reading(C, step, writer.real).function(report.program) for report in step.code.reports}
    bodies["tune"] = _nominal_unless_marked(step) + writer.function(step.code.tuning)
    bodies |= {section.name: writer.function(section.program) for section in step.code.time}
    tune, reset, *set_time = (
        prototypes(step)[name].call(same_name) for name in ("tune", "reset", *(each.name for each in step.code.time))
    )
    bodies["reset"] = _reset(writer) + code(*(f"{call};" for call in set_time), parameters="st")
    bodies["init"] = code(f"{nominal(step).call(same_name)};", f"(void){tune};", f"{reset};", parameters="pst")
    return bodies, functions


def _includes(step: Step, chosen: list[str], uses: Uses) -> list[str]:
    wide = uses.widest > 0xFFFF
    lines = ["#include <limits.h>"] if wide else []
    lines += [f"#include <{header}>" for header in sorted({_HEADERS[kind] for kind in uses.types})]
    lines += chosen
    lines += [""] if lines else []
    guard = [
        "#if UINT_MAX <= 0xFFFF",
        f'#error "{step.name} counts beyond 65535: int has too few bits here"',
        "#endif",
        "",
    ]
    return lines + (guard if wide else [])


def _function(prototype: Prototype, body: Code, *attributes: str) -> Code:
    idle = [parameter.name for parameter in prototype.parameters if parameter.name not in body.uses.parameters]
    inner = code(*(f"(void){name};" for name in idle)) + body
    if prototype.returns != "void":
        inner = code(f"{prototype.returns} status = 0u;") + inner + code("return status;")
    heading = [C.comment(prototype.meaning)] if prototype.meaning and not prototype.public else []
    return code(*heading, *attributes, str(prototype), "{") + inner.indented() + code("}")


def _assign(start: str, item: Field, real: Real, least: int) -> Code:
    counts = item.kind == "index"
    texts = [C.literal(value, "unsigned" if counts else real) for value in item.initial]
    widest = int(max(item.initial)) if counts else 0
    if item.size >= least and len(set(texts)) == 1:
        (head,) = C.loop("j", C.number(0), C.number(item.size), "", True)
        return braced(head, code(f"{start}{item.name}[j] = {texts[0]};")) + code(widest=max(widest, item.size))
    places = [f"{start}{item.name}{f'[{i}]' if item.size > 1 else ''}" for i in range(item.size)]
    return code(*(f"{place} = {text};" for place, text in zip(places, texts, strict=True)), widest=widest)


def _least(step: Step, item: Field) -> int:
    return NEVER if item.entries and step.clock.prefer == "speed" else LEAST[step.clock.prefer]


def _reset(writer: SharingWriter) -> Code:
    """Return the C statements that set a step's state to its initial values;
    members of a bank come last, because they start from the estimate."""
    step, real, done = writer.step, writer.real, writer.resetting
    marked = (f"s->{step.layout.mark.name} = {step.name.upper()}_READY;",) if step.layout.mark else ()
    lines = code(*marked, parameters="s")
    for item in step.layout.state:
        if Place("state", item.name) not in done:
            lines += _assign("s->", item, real, _least(step, item))
    lines += _fresh("s->", writer, step.layout.groups)
    return lines + joined(part.call for part in dict.fromkeys(done.values()))


def _fresh(start: str, writer: SharingWriter, groups: Iterable[Group], k: str = "k") -> Code:
    lines = Code()
    for group in groups:
        one = f"{start}{group.name}[{k}]."
        fields = (f for f in group.fields if Place(group.name, f.name) not in writer.resetting)
        inner = joined(_assign(one, f, writer.real, _least(writer.step, f)) for f in fields)
        inner += _fresh(one, writer, group.groups, "k2")
        if inner.lines:
            head = f"for (unsigned {k} = 0u; {k} < {group.count}u; ++{k}) {{"
            lines += braced(head, inner) + code(widest=group.count)
    return lines


def _nominal(step: Step, real: Real) -> Code:
    plant = (replace(item, name=C.name(item.name)) for item in step.layout.plant)
    kinds = (("plant", plant), ("gain", step.layout.gains))
    marked = (f"p->{step.layout.mark.name} = {step.name.upper()}_READY;",) if step.layout.mark else ()
    lines = joined(_assign(f"p->{kind}.", f, real, _least(step, f)) for kind, fields in kinds for f in fields)
    return code(*marked) + lines + code(parameters="p" if marked or lines.lines else "")


def _nominal_unless_marked(step: Step) -> Code:
    if not step.layout.mark:
        return Code()
    upper, call = step.name.upper(), nominal(step).call(same_name)
    test = f"if (p->{step.layout.mark.name} != {upper}_READY) {{"
    return braced(test, code(f"{call};", f"status = {upper}_{NO_PARAMETERS.name};", parameters="p"))
