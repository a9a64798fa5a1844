"""The package as its own files show it: who imports whom, and how large, how deep and how dense it is.

    .venv/bin/python tests/house.py [--tests]

prints measures, a row each; `--tests` also runs the ordinary tests, as a newcomer does. A *function* is a definition
with a name, a method too; it has one caller where its name is used in one place of the package. A *door* is the
function of a command, and all that only it calls. A *climb* is a pair of folders: a function of the first calls one of
the second, which stands above it, by a value that was handed down.
"""

import argparse
import ast
import resource
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Callable, Iterator
from functools import cache
from pathlib import Path
from types import FrameType

ROOT = Path(__file__).resolve().parents[1]
PACKAGE = ROOT / "hgogen"
COLUMN = (  # the folders, each standing on those before it only
    *("rigor", "recheck", "reading", "analysis", "discretisation", "forms", "estimators", "prove", "stepping"),
    *("methods", "observers", "certificates", "emit", "targets", "run", "modelfiles", "logs", "extras", "commands"),
)
FOLDERS = ("forms", "observers", "methods", "targets")  # of cases; the contract is the singular file
PROOFS = ("prove", "certificates", "recheck", "analysis/evidence.py")
FEW = 120  # lines of a module that may belong into its one importer
FILES = {
    ".".join(("hgogen", *path.relative_to(PACKAGE).with_suffix("").parts)).removesuffix(".__init__"): path
    for path in sorted(PACKAGE.rglob("*.py"))
}
INNER = [name for name in FILES if name.count(".") == 2]
CASES = [name for name in INNER if name.split(".")[1] in FOLDERS]


def tree(name: str) -> ast.Module:
    """The syntax of a module of the package."""
    return parsed(FILES[name])


def stub(name: str) -> ast.Module:
    """The syntax of what says which names a module gives, where it imports them when they are asked for."""
    path = FILES[name].with_suffix(".pyi")
    return parsed(path) if path.is_file() else ast.Module([], [])


@cache
def parsed(path: Path) -> ast.Module:
    """The syntax of a file."""
    return ast.parse(path.read_text(), str(path))


@cache
def within(node: ast.AST) -> tuple[ast.AST, ...]:
    """A node and all that is in it, which many rules go through, but whether a name is read or set: `ast.walk` takes
    eight times as long."""
    nodes = [node]
    for each in nodes:  # which grows on the way
        for name in each._fields:
            part = getattr(each, name)
            if isinstance(part, list):
                nodes += [one for one in part if isinstance(one, ast.AST)]
            elif isinstance(part, ast.AST) and not isinstance(part, ast.expr_context):
                nodes.append(part)
    return tuple(nodes)


# --- who imports whom ---------------------------------------------------------------------------------------


def alone(name: str) -> bool:
    """Whether a file is the checker's, which shares nothing with the rest."""
    return name.startswith("hgogen.recheck")


def library(node: ast.ImportFrom) -> bool:
    """Whether an import is of what does not belong to the package."""
    return not node.level and str(node.module).partition(".")[0] != "hgogen"


@cache
def imports(name: str) -> frozenset[str]:
    """The modules of the package that a module imports, anywhere in it, for types as well; a folder imports its
    cases. Relative are the imports of the checker alone, whose folder can be copied."""
    modules = set()
    for node in (*within(tree(name)), *within(stub(name))):
        if isinstance(node, ast.Import):
            modules |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert bool(node.level) is (alone(name) and not library(node)), f"{name} imports {ast.unparse(node)}"
            source = str(node.module)
            if node.level:
                folder = name if FILES[name].name == "__init__.py" else name.rpartition(".")[0]
                above = folder.rsplit(".", node.level - 1)[0]
                source = f"{above}.{node.module}" if node.module else above
            inner = {f"{source}.{alias.name}" for alias in node.names}
            modules |= {module for module in inner if module in FILES}
            modules |= {source} if inner - FILES.keys() else set()
    if name.removeprefix("hgogen.") in FOLDERS:
        modules |= {case for case in CASES if case.startswith(f"{name}.")}
    return frozenset(modules & FILES.keys())


@cache
def below(name: str) -> frozenset[str]:
    """All that a module imports, by whatever way."""
    reached: set[str] = set()
    left = {name}
    while left:
        new = imports(left.pop()) - reached
        reached |= new
        left |= new
    return frozenset(reached)


# --- measures -----------------------------------------------------------------------------------------------

Function = ast.FunctionDef | ast.AsyncFunctionDef


def length(path: Path) -> int:
    """The lines of a file."""
    return len(path.read_text().splitlines())


def total(*places: str) -> int:
    """The lines of the package, or of some of its folders and files: of code, templates and tables."""
    paths = (path for place in places or ("",) for path in (PACKAGE / place, *(PACKAGE / place).rglob("*")))
    return sum(length(path) for path in paths if path.is_file() and path.suffix != ".pyc")


@cache
def functions() -> tuple[tuple[str, Function], ...]:
    """(module, definition) of all functions of the package."""
    return tuple((name, node) for name in FILES for node in within(tree(name)) if isinstance(node, Function))


def uses(*nodes: ast.AST) -> Counter[str]:
    """How often each name is used in these."""
    inner = (node for each in nodes for node in within(each))
    return Counter(
        node.id if isinstance(node, ast.Name) else node.attr
        for node in inner
        if isinstance(node, ast.Name | ast.Attribute)
    )


@cache
def all_uses() -> Counter[str]:
    """How often each name is used in the package."""
    return sum((in_module(name) for name in FILES), Counter())


def callers(module: str, function: Function) -> int:
    """In how many places a function is used: a private one of its module, another of the package."""
    return (in_module(module) if function.name.startswith("_") else all_uses())[function.name]


@cache
def in_module(name: str) -> Counter[str]:
    """How often each name is used in a module."""
    return uses(tree(name))


def small_modules() -> list[str]:
    """Modules of few lines with one importer, in their own folder."""
    importers: dict[str, list[str]] = {name: [] for name in FILES}
    for name in FILES:
        for other in imports(name):
            importers[other].append(name)

    def folder(name: str) -> str:
        return name.rpartition(".")[0]

    return [
        name
        for name, by in importers.items()
        if len(by) == 1 and folder(name) == folder(by[0]) and length(FILES[name]) < FEW
    ]


def statements(function: Function) -> int:
    """How many statements a function has, with those of the functions in it, but no docstring."""
    return sum(isinstance(node, ast.stmt) for node in within(function)) - 1 - bool(ast.get_docstring(function))


def doors() -> dict[str, tuple[int, int]]:
    """The lines of the function of each command, and with those that only it calls."""
    return {
        node.name.rstrip("_"): door(node)
        for name, node in functions()
        if name.startswith("hgogen.commands.") and node.name.endswith("_") and not node.name.startswith("_")
    }


@cache
def defined() -> dict[str, list[Function]]:
    """The functions by their names."""
    by: dict[str, list[Function]] = {}
    for _, node in functions():
        by.setdefault(node.name, []).append(node)
    return by


def door(function: Function) -> tuple[int, int]:
    """The lines of a function, and with those that only it calls, by whatever way."""
    inner = [function]
    for node in inner:  # which grows on the way
        called = uses(*inner)
        names = [name for name in uses(node) if called[name] == all_uses()[name] and len(defined().get(name, ())) == 1]
        inner += [other for name in names for other in defined()[name] if other not in inner]
    lines = [(node.end_lineno or 0) - node.lineno + 1 for node in inner]
    return lines[0], sum(lines)


PENDULUM = """
import hgogen as hg, sympy as sp
q, w = hg.Signal("q", "rad", "angle", low=-4, high=4), hg.Signal("w", "rad/s", "rate", low=-20, high=20)
plant = hg.System("p", states=(q, w), outputs=(hg.Signal("y", "rad", "angle"),), flow=[w, -20*sp.sin(q)], output=[q])
observer = hg.observers.high_gain(hg.forms.triangular(plant), theta=20, poles=(-1, -1))
"""
NOISE = f"{PENDULUM}assert hg.noise_gain(hg.sample(observer, hg.methods.rk4, dt=1e-3)).gains\n"


def reached(code: str) -> int:
    """How many modules of the package a program imports."""
    count = "import sys; print(sum(name.split('.')[0] == 'hgogen' for name in sys.modules))"
    return int(run([sys.executable, "-c", code + count]).split()[-1])


def run(command: list[str]) -> str:
    """What a command writes."""
    return subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True).stdout


@cache
def folder(file: str) -> str:
    """The folder of the package in which a file stands, "" for one at its root or of a library."""
    path = Path(file)
    inner = path.relative_to(PACKAGE).parts if path.is_relative_to(PACKAGE) else ()
    return inner[0] if len(inner) > 1 else ""


def calls(function: Callable[[], object]) -> set[tuple[str, str]]:
    """The pairs of folders of which one calls the other, by whatever way between them, while a function runs."""
    pairs: set[tuple[str, str]] = set()

    def called(frame: FrameType, event: str, _: object) -> None:
        callee, caller = folder(frame.f_code.co_filename), frame.f_back
        while event == "call" and callee and caller is not None:
            if above := folder(caller.f_code.co_filename):
                pairs.add((above, callee))
                return
            caller = caller.f_back

    sys.setprofile(called)
    try:
        function()
    finally:
        sys.setprofile(None)
    return {(caller, callee) for caller, callee in pairs if caller != callee}


def climbs(call: Callable[[], object]) -> set[tuple[str, str]]:
    """The pairs of folders by which a call climbs."""
    return {pair for pair in calls(call) if COLUMN.index(pair[0]) < COLUMN.index(pair[1])}


def walks() -> tuple[int, int]:
    """The climbs of `hg.sample` and of `targets.c99`, each asked for the first time."""
    import hgogen as hg

    space: dict[str, object] = {}
    exec(PENDULUM, space)
    steps: list[hg.Step] = []
    sampled = climbs(lambda: steps.append(hg.sample(space["observer"], hg.methods.rk4, dt=1e-3)))
    return len(sampled), len(climbs(lambda: hg.targets.c99(*steps)))


def measures() -> Iterator[tuple[str, str]]:
    """The rows of the table."""
    from hgogen.recheck.rules import RULES

    code = [line for path in FILES.values() for line in path.read_text().splitlines() if line.strip()]
    named = [(name, node) for name, node in functions() if not node.name.startswith("__")]
    once = [node.name for name, node in named if callers(name, node) == 1]
    private = [name for name in once if name.startswith("_")]
    sizes = [statements(node) for _, node in functions()]
    widest = max(doors().items(), key=lambda each: each[1][1])
    yield "lines of the package", f"{total():,}"
    yield f"lines of {', '.join(PROOFS)}", f"{total(*PROOFS):,}"
    yield "modules, folders", f"{len(FILES)}, {len(COLUMN)}"
    yield "rules of recheck", f"{len(RULES)}"
    yield "modules that a proof of noise imports", f"{reached(NOISE)}"
    yield "functions with one caller: private, all", f"{len(private) / len(named):.1%}, {len(once) / len(named):.1%}"
    yield f"modules with one importer, in their folder, below {FEW} lines", f"{len(small_modules())}"
    yield "climbs: hg.sample, targets.c99", "{}, {}".format(*walks())
    yield "longest door of a command: its lines, with what only it calls", f"{widest[0]} {widest[1][0]}, {widest[1][1]}"
    yield "characters of a line that is not empty", f"{sum(map(len, code)) / len(code):.1f}"
    yield "statements of a function: mean, most", f"{sum(sizes) / len(sizes):.2f}, {max(sizes)}"


def of_tests() -> Iterator[tuple[str, str]]:
    """The rows of the ordinary tests."""
    for what, options in (("collect", ["--collect-only", "-n", "0"]), ("run", [])):
        before, begun = cpu(), time.perf_counter()
        last = subprocess.run(
            [sys.executable, "-m", "pytest", "-q", *options], cwd=ROOT, capture_output=True, text=True
        )
        took = f"{cpu() - before:.1f} s of CPU, {time.perf_counter() - begun:.0f} s"
        lines = last.stdout.splitlines()
        yield f"ordinary tests, to {what} them", f"{took}: {lines[-1]}"
        yield from (("", line) for line in lines if line.startswith(("FAILED ", "ERROR ")))


def cpu() -> float:
    """The time in s that processes took which have ended."""
    usage = resource.getrusage(resource.RUSAGE_CHILDREN)
    return usage.ru_utime + usage.ru_stime


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--tests", action="store_true", help="collect and run the ordinary tests as well")
    for what, value in (*measures(), *(of_tests() if parser.parse_args().tests else ())):
        print(f"{what:62} {value}", flush=True)


if __name__ == "__main__":
    main()
