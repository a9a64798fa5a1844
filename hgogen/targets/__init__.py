"""Targets: each file is a case, a function from a Step to Files.

`Files` are texts by name, each of which begins with the step's; only `hgogen/target.py` writes. A target takes the step
and, by name, `real`, and refuses what is neither by `demand_step` and `demand_real`. One that gives more than texts, as
`casadi.py` gives functions, gives a kind of `Files` that holds it. `markdown.py` is written beside every language.

A language takes `step, *, real, command, check`; `build` and `generate` offer it by `--target`. `command` is what made
the files, for their banner. With `check` it writes a program NAME_check besides, which runs the vectors of
`hgogen/emit/pystep.py`, prints `NAME: 64 samples as recorded` and ends with 0, or with 1 at the first that differs;
and its `Sources` hold a recipe: the commands that compile and run it in a folder of the files. A language has braces
and C's operators; its `Syntax` is data (`hgogen/emit/syntax.py`), and one that is near C is `replace(C, ..)`. Every
function of a file's own is called `prefix`, that of its `Writer`, an underscore, and its name. A file here or in
`emit/` that takes a text apart says which, in a comment `# Takes apart: ...`.
"""

from hgogen.registry import cases_of

__all__, __dir__, __getattr__ = cases_of(__name__)
