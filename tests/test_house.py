"""The rules of the house: who imports whom, what a case file holds, how long a file is, who writes to the disk."""

import ast
import re
import shutil
import subprocess
from collections.abc import Iterator
from dataclasses import is_dataclass
from importlib import import_module
from pathlib import Path
from string import Formatter

import pages
import pytest
from house import (
    CASES,
    COLUMN,
    FILES,
    FOLDERS,
    INNER,
    ROOT,
    alone,
    below,
    doors,
    functions,
    imports,
    measures,
    parsed,
    statements,
    tree,
    within,
)

import hgogen as hg
from hgogen.errors import HgogenError
from hgogen.recheck.text import RecheckError

TESTS = ROOT / "tests"
CONTRACTS = ("form", "observer", "method", "target", "step")
WRITERS = {"hgogen.target"}  # emission is pure; the rest hands text to `target.write`
ROOMS = sorted({name.split(".")[1] for name in INNER} - set(FOLDERS))  # what contracts and cases share


def called(node: ast.expr) -> str:
    """The dotted name that a call is of; "" where it is of something else."""
    if isinstance(node, ast.Attribute):
        start = called(node.value)
        return start and f"{start}.{node.attr}"
    return node.id if isinstance(node, ast.Name) else ""


# --- imports ------------------------------------------------------------------------------------------------


def test_the_graph_is_there() -> None:
    """So that the tests below cannot pass on nothing."""
    assert len(FILES) > 50
    assert len(CASES) >= 11
    assert len(ROOMS) > 5
    assert "hgogen.observers.riccati" in below("hgogen")
    assert "hgogen.observer" in imports("hgogen.step")
    assert "hgogen.methods.rk4" in below("hgogen.call")


def test_imports_make_no_circle() -> None:
    assert not [name for name in FILES if name in below(name)]


def test_a_contract_knows_no_case() -> None:
    known = {contract: cases_below(f"hgogen.{contract}") for contract in CONTRACTS}
    assert not {contract: cases for contract, cases in known.items() if cases}


def test_a_case_knows_no_other_case() -> None:
    known = {case: cases_below(case) for case in CASES}
    assert not {case: cases for case, cases in known.items() if cases}


def cases_below(name: str) -> list[str]:
    return [other for other in below(name) if other.split(".")[1] in FOLDERS]


def rooms(folder: str) -> set[str]:
    """The other folders that the files of a folder import."""
    inner = {module for name in FILES if name.startswith(f"hgogen.{folder}.") for module in imports(name)}
    return {module.split(".")[1] for module in inner if module.count(".") == 2} - {folder}


def test_folders_stand_one_on_the_other() -> None:
    """Each imports only those before it in the column, which the page of the architecture lists."""
    assert set(COLUMN) == {*ROOMS, *FOLDERS}
    assert "rigor" in rooms("analysis")
    for k, folder in enumerate(COLUMN):
        assert rooms(folder) <= set(COLUMN[:k]), folder
    assert tuple(re.findall(r"^\| `(\w+)/` \|", pages.text("architecture"), re.MULTILINE)) == COLUMN


def test_no_two_files_have_one_name() -> None:
    """But for a contract and its folder; the checker of certificates stands alone."""
    names = [name.split(".")[1:] for name in FILES if not alone(name)]
    last = [name[-1] for name in names if name]
    assert not {name for name in last if last.count(name) > 1}


def test_the_root_holds_the_contracts_and_little_else() -> None:
    assert len([name for name in FILES if name.count(".") == 1 and FILES[name].name != "__init__.py"]) <= 22


def test_a_room_says_what_it_holds() -> None:
    """In one line, and nothing else: what a room holds is imported from its file."""
    for room in ROOMS:
        (line,) = tree(f"hgogen.{room}").body
        assert isinstance(line, ast.Expr), room
        assert "\n" not in ast.literal_eval(line.value), room


def test_only_the_command_line_knows_the_command_line() -> None:
    assert [name for name in FILES if "hgogen.cli" in imports(name)] == ["hgogen.__main__"]


# --- cases --------------------------------------------------------------------------------------------------


def test_a_case_has_its_own_name_and_a_reference() -> None:
    """A form and an observer name their paper, a method its equation."""
    for case in CASES:
        _, folder, name = case.split(".")
        assert hasattr(getattr(hg, folder), name), case
        assert not isinstance(getattr(getattr(hg, folder), name), type(hg)), case
        text = ast.get_docstring(tree(case)) or ""
        if folder in ("forms", "observers"):
            assert re.search(r"\b(19|20)\d\d\b", text), f"{case} names no paper with its year"
            assert re.search(r"'\s*=|=", text), f"{case} shows no equation"
        else:
            assert len(text) > 40, case


def test_every_folder_gives_all_its_cases() -> None:
    for folder in FOLDERS:
        files = {case.split(".")[2] for case in CASES if case.split(".")[1] == folder}
        assert set(getattr(hg, folder).__all__) == files


# --- files --------------------------------------------------------------------------------------------------


def test_no_file_is_long() -> None:
    assert not [name for name, path in FILES.items() if len(path.read_text().splitlines()) > 1_000]


def test_everything_public_has_a_docstring() -> None:
    kinds = ast.FunctionDef | ast.ClassDef

    def shown(body: list[ast.stmt]) -> list[ast.FunctionDef | ast.ClassDef]:
        return [node for node in body if isinstance(node, kinds) and not node.name.startswith("_")]

    bare = [name for name in FILES if not ast.get_docstring(tree(name))]
    for name in FILES:
        public = shown(tree(name).body)
        public += [inner for node in public if isinstance(node, ast.ClassDef) for inner in shown(node.body)]
        bare += [f"{name}.{node.name}" for node in public if not ast.get_docstring(node)]
    assert not bare


WRITES = re.compile(
    r"open\([^)]*[\"'][wax]b?\+?[\"']|O_CREAT|fdopen|write_text|write_bytes|mkdir|makedirs|mkstemp|copyfile|os\.replace"
    r"|rmtree|unlink"
)


def test_few_write_to_the_disk() -> None:
    assert {name for name, path in FILES.items() if WRITES.search(path.read_text())} == WRITERS


def test_only_a_models_own_code_is_executed() -> None:
    """No expression of a user is evaluated as Python, but for the model file that he gives: the text that a graph
    becomes holds operations, numbers and names of our own (`tests/test_sample.py`)."""
    calls = {
        (name, node.func.id)
        for name in FILES
        for node in within(tree(name))
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id in ("eval", "exec")
    }
    assert calls == {("hgogen.model", "exec"), ("hgogen.emit.pygraph", "exec")}


TEXT_METHODS = {"replace", "split", "rsplit", "splitlines", "partition", "rpartition", "removeprefix", "removesuffix"}


def test_no_printer_reads_what_it_printed() -> None:
    """What a line of C uses comes with the line (`emit.code`), a function is declared and called from data, and a
    place is a value. A file between a program and its text that takes a text apart says which, and no other does."""
    rooms_ = {"emit", "targets", "stepping", "calling", "program", "step"}
    files = {name for name in FILES if name.split(".")[1:2] and name.split(".")[1] in rooms_}
    assert len(files) > 30
    marked = {name for name in files if re.search(r"^# Takes apart: [^.]+\.$", FILES[name].read_text(), re.MULTILINE)}
    assert {name for name in files if takes_apart(name)} == marked
    assert "hgogen.emit.printer" not in marked


def takes_apart(name: str) -> bool:
    """Whether a file imports re, or calls a method that takes a text apart; numpy's `split` is none."""
    modules = {alias.name for node in within(tree(name)) if isinstance(node, ast.Import) for alias in node.names}
    modules |= {node.module for node in within(tree(name)) if isinstance(node, ast.ImportFrom) and node.module}
    methods = (
        node.func for node in within(tree(name)) if isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute)
    )
    return "re" in modules or any(
        method.attr in TEXT_METHODS and called(method.value) not in ("np", "self") for method in methods
    )


# --- names --------------------------------------------------------------------------------------------------

SAYS_NOTHING = {"found", "told", "kept", "given", "near", "apart", "dear"}
NAMING = (ast.Name, ast.arg, ast.ExceptHandler, ast.MatchAs, ast.MatchStar, ast.alias, ast.FunctionDef, ast.ClassDef)


def lines(node: ast.AST) -> Iterator[ast.AST]:
    """The statements in a statement, and in those: no expression holds one."""
    for block in ("body", "orelse", "finalbody", "handlers", "cases"):
        for line in getattr(node, block, ()):
            yield line
            yield from lines(line)


def names(module: ast.AST) -> Iterator[tuple[int, str]]:
    """The line and name of each variable, argument, and private or inner function or class; a public function, class
    or field is a name that users read."""
    fields = {
        target
        for node in within(module)
        if isinstance(node, ast.ClassDef)
        for line in node.body
        for target in (line.targets if isinstance(line, ast.Assign) else [getattr(line, "target", None)])
    }
    for node in (node for node in within(module) if isinstance(node, NAMING)):
        if isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store) and node not in fields:
            yield node.lineno, node.id
        elif isinstance(node, ast.arg):
            yield node.lineno, node.arg
        elif isinstance(node, ast.ExceptHandler | ast.MatchAs | ast.MatchStar) and node.name:
            yield node.lineno, node.name
        elif isinstance(node, ast.alias) and node.asname:
            yield node.lineno, node.asname
        elif isinstance(node, ast.FunctionDef):
            yield from (
                (line.lineno, line.name) for line in lines(node) if isinstance(line, ast.FunctionDef | ast.ClassDef)
            )
        if isinstance(node, ast.FunctionDef | ast.ClassDef) and node.name.startswith("_"):
            yield node.lineno, node.name


def say_nothing(module: ast.AST) -> list[tuple[int, str]]:
    return sorted({(line, name) for line, name in names(module) if name.strip("_").lower() in SAYS_NOTHING})


@pytest.mark.parametrize(
    "text",
    [
        "found = 1",
        "for near, far in pairs: pass",
        "[kept for kept in rows]",
        "with opened() as given: pass",
        "if told := read(): pass",
        "def of(given): pass",
        "def of(*, apart=1): pass",
        "lambda dear: dear",
        "def _found(): pass",
        "def whole():\n    def kept(): pass",
        "class Box:\n    def _near(self): pass",
        "try: pass\nexcept ValueError as told: pass",
        "import numpy as near",
        "match row:\n    case [found, *kept]: pass",
    ],
)
def test_the_search_for_names_sees_every_kind(text: str) -> None:
    assert say_nothing(ast.parse(text))


@pytest.mark.parametrize("text", ["class Row:\n    found: str", "def apart(): pass", "row.found = near(kept)"])
def test_it_passes_public_names_and_uses(text: str) -> None:
    assert not say_nothing(ast.parse(text))


def test_a_value_is_named_for_what_it_holds() -> None:
    """A local called found or kept can be anything, and cannot be searched for: a solution, a bound and an index are
    called so, in the tests and their fixtures as in the package."""
    paths = (*FILES.values(), *sorted(TESTS.rglob("*.py")))
    assert Path(__file__).resolve() in paths
    words = re.compile(rf"\b_*(?:{'|'.join(SAYS_NOTHING)})_*\b", re.IGNORECASE)
    holding = [path for path in paths if words.search(path.read_text())]  # the others have no such name
    assert not [
        f"{path.relative_to(ROOT)}:{line}: {name}" for path in holding for line, name in say_nothing(parsed(path))
    ]


# --- words --------------------------------------------------------------------------------------------------

PRIVATE = {
    *re.findall(r"\w+", "bend bends bent shows shown sees seen tells told hopeless said asked taken held made")
} | {
    *re.findall(
        r"\w+", "rest rests beside doubt patience quiet calm worth dear entering enters moves moved stands goes"
    )
}
ALLOWED = {
    **dict.fromkeys(("held_out", "HeldOut", "HELD_OUT"), "records that are held out, as statistics has it; --held-out"),
    "held": "what stays constant, as by a zero-order hold; users read it",
    "shown": "users call hg.excitation.shown",
}
ORDINARY = {
    "moves",
    "moved",
    "held",
    "taken",
    "rests",
    "quiet",
}  # in a sentence: a plant that rests, noise that moves a state
OPENING = re.compile(
    r"(Those|That|The same|It|What|Which|As|Of|By|Where|From|With|If|Such|These|This|There|And|Or|To|In|On)\b"
)


def words_of(name: str) -> set[str]:
    """The words of a name, in lower case, whether it is written with underscores or with capitals."""
    return {*re.sub(r"([a-z0-9])([A-Z])", r"\1_\2", name).lower().split("_")}


def every_name(module: ast.AST) -> Iterator[tuple[int, str]]:
    """The line and name of each function, class, field, argument and variable, whether users read it or not."""
    yield from names(module)
    for node in within(module):
        if isinstance(node, ast.FunctionDef | ast.ClassDef):
            yield node.lineno, node.name
        elif isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store):
            yield node.lineno, node.id


def test_words_of_a_name_are_told_apart() -> None:
    assert words_of("_held_Rows") == {"", "held", "rows"}
    assert words_of("TooDear") == {"too", "dear"}


@pytest.mark.parametrize(
    "text", ["def rows_held(): pass", "class Shown: pass", "class A:\n    said: str", "def f(told): pass"]
)
def test_a_private_word_is_seen_in_every_name(text: str) -> None:
    assert [name for _, name in every_name(ast.parse(text)) if words_of(name) & PRIVATE]


def test_names_are_the_fields_own_terms() -> None:
    """A reader searches for the term that textbooks have: a residual, not what is left; a log, not what was said."""
    every = [(name, line, text) for name, path in FILES.items() for line, text in every_name(parsed(path))]
    assert not [one for one in every if words_of(one[2]) & PRIVATE and one[2] not in ALLOWED]
    assert {text for _, _, text in every} >= ALLOWED.keys()


def docstrings() -> Iterator[tuple[str, int, str]]:
    """The module, line and text of each docstring of the package."""
    for name, path in FILES.items():
        for node in (parsed(path), *within(parsed(path))):
            if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef) and (text := ast.get_docstring(node)):
                yield name, getattr(node, "lineno", 1), text


def test_a_docstring_begins_with_what_is_returned() -> None:
    """Or with a verb: not with a pronoun or a preposition, of which nobody knows what it stands for."""
    assert not [one for one in docstrings() if OPENING.match(one[2])]


def test_the_first_line_of_a_docstring_has_no_private_word() -> None:
    words = PRIVATE - ORDINARY
    lines = ((name, line, re.sub("`[^`]*`", "", text.partition("\n")[0])) for name, line, text in docstrings())
    assert not [one for one in lines if words & {*re.findall(r"[a-z]+", one[2].lower())}]


# --- values and errors --------------------------------------------------------------------------------------


def subclasses(kind: type) -> set[type]:
    return {kind}.union(*(subclasses(inner) for inner in kind.__subclasses__()))


def test_an_error_is_a_dataclass_with_a_sentence() -> None:
    """Not a frozen one: Python writes the traceback into it."""
    for name in FILES:
        if not name.endswith("__main__"):
            import_module(name)
    bases = {HgogenError, RecheckError}
    errors = [kind for base in bases for kind in subclasses(base) - bases if kind.__module__ in FILES]
    assert len(errors) > 40
    for kind in errors:
        assert is_dataclass(kind), kind
        assert not kind.__dataclass_params__.frozen, kind
        assert kind.__str__ is not Exception.__str__, kind
        assert kind.__doc__, kind
        error = kind.__new__(kind)
        error.__traceback__ = None
        error.add_note("a note")


def test_values_are_frozen() -> None:
    """Every dataclass but errors, and the printers', which count uses and number locals as they go."""
    loose = {
        f"{name}.{node.name}"
        for name in FILES
        for node in within(tree(name))
        if isinstance(node, ast.ClassDef) and not {"HgogenError", "RecheckError"} & set(map(ast.unparse, node.bases))
        for decorator in map(ast.unparse, node.decorator_list)
        if decorator.startswith("dataclass") and "frozen=True" not in decorator
    }
    printers = {"node.Node", "printer.Printer", "pygraph.Writer"}
    assert loose <= {f"hgogen.emit.{name}" for name in printers}


# --- claims -------------------------------------------------------------------------------------------------

CUTS = {"partition", "rpartition", "split", "rsplit", "startswith", "endswith", "removeprefix", "removesuffix"}
WRITTEN = {"hgogen.commands.checking"}  # of claims as a page shows them


def is_id(node: ast.AST) -> bool:
    return (isinstance(node, ast.Name) and node.id == "id") or (isinstance(node, ast.Attribute) and node.attr == "id")


def parses_an_id(node: ast.AST) -> bool:
    """A method that cuts it, a search in it, or a comparison with a text."""
    if isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute):
        return node.func.attr in CUTS and is_id(node.func.value)
    if isinstance(node, ast.Compare):
        sides = (node.left, *node.comparators)
        return any(map(is_id, sides)) and any(isinstance(side, ast.Constant | ast.JoinedStr) for side in sides)
    return False


def test_no_text_is_parsed_for_what_is_claimed() -> None:
    """The name of a claim has parts, which are read; the checker of certificates reads files, which have texts."""
    assert parses_an_id(ast.parse('check.id.endswith(".theta")', mode="eval").body)
    assert parses_an_id(ast.parse('id == "phase.rank"', mode="eval").body)
    ours = [name for name in FILES if not name.startswith("hgogen.recheck")]
    assert not [name for name in ours if any(map(parses_an_id, within(tree(name))))]


def test_who_knows_claims_searches_no_texts() -> None:
    claiming = [name for name in FILES if "hgogen.check" in imports(name)]
    assert len(claiming) > 50
    assert {name for name in claiming if "re" in standard(name)} == WRITTEN
    assert not [name for name in FILES if "fnmatch" in standard(name)]


PATTERNED = {"because", "Reason", "Reason.of", "Sentence", "Sentence.of"}  # called with a pattern first
REASONED = {"Check": 3, "Sign": 4, "Lipschitz": 3, "Answer": 1, "Nothing": 0, "Hypothesis": 3, "Row": 2, "answer": 1}


def writes(node: ast.AST) -> bool:
    """Whether a text is made where it stands, of other texts or of numbers."""
    if isinstance(node, ast.IfExp | ast.BoolOp):
        return any(map(writes, [node.body, node.orelse] if isinstance(node, ast.IfExp) else node.values))
    if isinstance(node, ast.Call):
        method = node.func.attr if isinstance(node.func, ast.Attribute) else called(node.func)
        return method in ("str", "join", "format")
    texts = isinstance(node, ast.BinOp) and any(
        isinstance(side, ast.Constant) and isinstance(side.value, str) for side in within(node)
    )
    return isinstance(node, ast.JoinedStr) or texts


def written_reasons(module: ast.AST) -> list[int]:
    """The lines where a pattern or a reason is a text that is made there, or above in the same function."""
    scopes = [module, *(node for node in within(module) if isinstance(node, ast.FunctionDef))]
    lines = set()
    for scope in scopes:
        assigned = [node for node in within(scope) if isinstance(node, ast.Assign)]
        made = {
            target.id
            for node in assigned
            for targets, values in [(node.targets[0], node.value)]
            for target, value in (
                zip(targets.elts, values.elts, strict=False)
                if isinstance(targets, ast.Tuple) and isinstance(values, ast.Tuple)
                else [(targets, values)]
            )
            if isinstance(target, ast.Name) and writes(value) and scope is not module
        }
        for node in within(scope):
            if not isinstance(node, ast.Call):
                continue
            case = called(node.func)
            place = 0 if case in PATTERNED else REASONED.get(case)
            handed = [keyword.value for keyword in node.keywords if keyword.arg == "reason"] if case in REASONED else []
            if case == "replace":
                handed = [keyword.value for keyword in node.keywords if keyword.arg == "reason"]
            if place is not None and len(node.args) > place:
                handed.append(node.args[place])
            lines |= {node.lineno for one in handed if writes(one) or (isinstance(one, ast.Name) and one.id in made)}
    return sorted(lines)


@pytest.mark.parametrize(
    "text",
    [
        'Check(id, "claim", verdict, f"it is {a}")',
        'Check(id, "claim", verdict, reason=f"it is {a}")',
        'Check(id, "claim", verdict, "it is " + a)',
        'Check(id, "claim", verdict, str(error))',
        'def of():\n    why = f"it is {a}"\n    return Check(id, "claim", verdict, why)',
        'def of():\n    why, fix = f"it is {a}", ""\n    return Check(id, "claim", verdict, why)',
        'replace(check, reason="it is {}".format(a))',
        'because(f"it is {a}")',
        'because("it is {a}" if a else f"it is no {b}", a=a)',
    ],
)
def test_the_search_for_written_reasons_sees_every_kind(text: str) -> None:
    assert written_reasons(ast.parse(text))
    assert not written_reasons(ast.parse('Check(id, f"{a}", verdict, because("it is {a}", a=f"{b}\'"))'))


def test_no_number_is_written_into_a_reason() -> None:
    """A reason holds its values as data, under a constant pattern; its text is made where it is printed."""
    assert not {name: lines for name in FILES if not alone(name) and (lines := written_reasons(tree(name)))}


def unnamed(module: ast.AST) -> list[int]:
    """The lines where a pattern names other values than those that come with it; one that is the name of a constant is
    that of the same function."""
    lines = []
    for scope in (node for node in within(module) if isinstance(node, ast.FunctionDef)):
        patterns: dict[str, list[ast.expr]] = {}
        for node in within(scope):
            if isinstance(node, ast.Assign) and isinstance(node.targets[0], ast.Name):
                patterns.setdefault(node.targets[0].id, []).append(node.value)
        for node in within(scope):
            if isinstance(node, ast.Call) and called(node.func) in PATTERNED and node.args:
                first = node.args[0]
                each = patterns.get(first.id, []) if isinstance(first, ast.Name) else [first]
                texts = {part.value for one in each for part in chosen(one) if isinstance(part, ast.Constant)}
                values = {str(keyword.arg) for keyword in node.keywords}
                if texts and values not in [fields(str(text)) for text in texts]:
                    lines.append(node.lineno)
    return lines


def chosen(node: ast.expr) -> list[ast.expr]:
    return [node.body, node.orelse] if isinstance(node, ast.IfExp) else [node]


def fields(pattern: str) -> set[str]:
    return {name for _, name, _, _ in Formatter().parse(pattern) if name is not None}


def test_a_pattern_names_the_values_that_come_with_it() -> None:
    """Also where no test goes, since a name too many would raise an error in the place of a verdict."""
    for text in ('because("it is {a}", b=1)', 'because("it is {}", b=1)', 'because("it is {a}")', 'because("it", a=1)'):
        assert unnamed(ast.parse(f"def of():\n    return {text}")), text
    assert unnamed(ast.parse('def of():\n    pattern = "it is {a}"\n    return because(pattern, b=1)'))
    assert not unnamed(
        ast.parse('def of():\n    pattern = "{a:g} {b: and }" if a else "{b} {a}"\n    because(pattern, a=1, b=2)')
    )
    assert not {name: lines for name in FILES if not alone(name) and (lines := unnamed(tree(name)))}


def cuts_a_reason(node: ast.AST) -> bool:
    """A method that cuts the text of a reason, a search in it, or a comparison with a text."""
    if isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute):
        return node.func.attr in CUTS | {"find", "index", "count", "replace"} and is_reason(node.func.value)
    if isinstance(node, ast.Compare):
        sides = (node.left, *node.comparators)
        return any(map(is_reason, sides)) and any(isinstance(side, ast.Constant | ast.JoinedStr) for side in sides)
    return isinstance(node, ast.Subscript) and isinstance(node.slice, ast.Slice) and is_reason(node.value)


def is_reason(node: ast.AST) -> bool:
    if isinstance(node, ast.Call) and called(node.func) == "str":
        return len(node.args) == 1 and is_reason(node.args[0])
    name = node.id if isinstance(node, ast.Name) else node.attr if isinstance(node, ast.Attribute) else ""
    return name in ("reason", "why")


def test_no_text_of_a_reason_is_read() -> None:
    """What a verdict rests on is in the values of its reason."""
    seen = ('check.reason.split(";")', '"box" in str(check.reason)', "str(row.why)[:9]", 'reason == "by hand"')
    assert all(cuts_a_reason(ast.parse(text, mode="eval").body) for text in seen)
    assert not [name for name in FILES if not alone(name) and any(map(cuts_a_reason, within(tree(name))))]


def standard(name: str) -> set[str]:
    """What a module imports by name, of Python's own among it."""
    imported = [node for node in within(tree(name)) if isinstance(node, ast.Import | ast.ImportFrom)]
    plain = {alias.name for node in imported if isinstance(node, ast.Import) for alias in node.names}
    return plain | {node.module or "" for node in imported if isinstance(node, ast.ImportFrom)}


# --- what is not said ---------------------------------------------------------------------------------------

WHERE = ("*", ".ci/*", "docs/*", "hgogen/**/*", "models/*", "tests/**/*", "generated/**/*")
READ = {"", ".yml", ".cff", ".txt", ".py", ".md", ".toml", ".c", ".h", ".ld", ".json", ".csv", ".svg"}
TEXTS = [
    path
    for pattern in WHERE
    for path in sorted(ROOT.glob(pattern))
    if path.is_file() and path.suffix in READ and path.name != ".git"
]
# Written so that no line of this file matches itself.
STRANGE = re.compile(
    r"/(?:[h]ome|[r]oot|[w]ork|[U]sers)/|[p]ypi\.|[p]ythonhosted|[l]ocalhost|\b(?:TO[D]O|FIX[M]E|XX[X])\b|\b[s]essions?\b"
    r"|\b[i]ssue #?\d|\b(?:A[I]|LL[M])\b|\b[a]gents?\b"
)


TOP = {
    *("pyproject.toml", "CITATION.cff", "LICENSE", "README.md", "CHANGELOG.md", "CONTRIBUTING.md"),
    *("hgogen", "models", "generated", "tests", "docs"),
}


def test_little_lies_at_the_top() -> None:
    """What is stored there, but for names that begin with a dot."""
    if not shutil.which("git"):
        pytest.skip("no git")
    listed = subprocess.run(["git", "ls-files"], cwd=ROOT, capture_output=True, text=True, check=False)
    if listed.returncode:
        pytest.skip("no clone")
    stored = {line.partition("/")[0] for line in listed.stdout.splitlines()}
    assert {name for name in stored if not name.startswith(".")} <= TOP
    assert all((ROOT / name).exists() for name in TOP)


def test_nothing_strange_is_said() -> None:
    """No path of one machine, no host of packages, no reminder, nothing of how the project came about."""
    assert len(TEXTS) > 80
    texts = {path: path.read_text(encoding="utf-8") for path in TEXTS}
    lines = [
        f"{path.relative_to(ROOT)}:{number}: {line.strip()[:80]}"
        for path, text in texts.items()
        if STRANGE.search(text)
        for number, line in enumerate(text.splitlines(), 1)
        if STRANGE.search(line)
    ]
    assert not lines


# --- measures -----------------------------------------------------------------------------------------------


def test_statements_are_counted_without_a_docstring() -> None:
    function = ast.parse("def f():\n    'It is f.'\n    a = 1\n    def g():\n        return a\n    return g").body[0]
    assert isinstance(function, ast.FunctionDef)
    assert statements(function) == 4


MOST = 25  # statements of a function
LONGER = {  # functions with more
    *("hgogen.commands.calibrating.tables", "hgogen.commands.calibrating.tune_", "hgogen.commands.fitting.fit_"),
    *("hgogen.logs.clocks.other_clocks", "hgogen.logs.findings.findings", "hgogen.logs.findings.still"),
    *("hgogen.logs.trends.explanations", "hgogen.logs.tune.tune"),
}


def test_no_function_is_long() -> None:
    """But a kernel, which becomes one function of C."""
    kernels = "hgogen.discretisation.kernels"
    long = {f"{name}.{node.name}" for name, node in functions() if name != kernels and statements(node) > MOST}
    assert long <= LONGER


@pytest.mark.full
def test_the_table_of_measures_is_there() -> None:
    rows = dict(measures())
    assert len(rows) == 11
    assert rows["modules, folders"] == f"{len(FILES)}, {len(COLUMN)}"
    assert all(int(number) > 0 for number in rows["climbs: hg.sample, targets.c99"].split(", "))
    assert {"run", "fit", "tune", "check"} <= doors().keys()
    assert all(0 < own <= whole for own, whole in doors().values())
