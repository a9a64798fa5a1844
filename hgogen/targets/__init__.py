"""Targets: each file is a case, a function from a Step to Files.

`Files` are texts by name, each of which begins with the step's; only `hgogen/target.py` writes. A target takes the step
and, by name, `real`, which `demand_step` and `demand_real` check. A target with more results than texts, as `casadi.py`
with its functions, returns a subclass of `Files`. `markdown.py` is written with every language.

A language takes `step, *, real, command, check`; `build` and `generate` offer it by `--target`. `command` is what made
the files, for their banner. With `check` it writes a program NAME_check besides, which runs the vectors of
`hgogen/emit/pystep.py`, prints `NAME: 64 samples as recorded` and ends with 0, or with 1 at the first that differs;
and its `Sources` hold a recipe: the commands that compile and run it in a folder of the files. A language has braces
and C's operators; its `Syntax` is data (`hgogen/emit/syntax.py`), and one that is near C is `replace(C, ..)`. A
function inside a file is named by the `prefix` of its `Writer`, an underscore, and its name. A file here or in `emit/`
that parses a text says which, in a comment `# Takes apart: ...`.
"""

from hgogen.registry import cases_of

__all__, __dir__, __getattr__ = cases_of(__name__)
