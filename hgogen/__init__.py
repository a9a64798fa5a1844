"""hgogen turns a plant into a step, through four values, and hands the step to readers.

plant : System --form--> Form --observer--> Observer --method, dt--> Step --target--> files
                                                                       --call------> numbers

A public name is imported at its first use, so that `import hgogen` takes no time. `__init__.pyi` lists the file of each
name, also for type checkers and editors.
"""

from importlib import import_module

# Takes apart: __init__.pyi, lines `from FILE import NAME as NAME`.
with open(f"{__file__}i", encoding="utf-8") as _stub:
    _FILES = {line.split()[3]: line.split()[1] for line in _stub if line.startswith("from ")}
__all__ = sorted(_FILES)


def __getattr__(name: str) -> object:
    if name == "__version__":
        value: object = import_module("hgogen.registry").version()
    elif name not in _FILES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}", name=name)
    else:
        holder = import_module(_FILES[name])
        value = import_module(f"{_FILES[name]}.{name}") if hasattr(holder, "__path__") else getattr(holder, name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__, "__version__"})
