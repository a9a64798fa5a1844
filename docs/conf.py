"""The site: `python -m sphinx -W -b html docs build/site`. Cells run while it is built, and no page needs the network.

Sphinx with the PyData theme is what the neighbours use (CasADi, python-control, do-mpc, SciPy), and both are released
several times a year. Equations become MathML while the site is built, since MathJax would be loaded from elsewhere.
"""

import sys
from pathlib import Path
from typing import Any

from docutils.nodes import SkipNode
from sphinx.application import Sphinx

sys.path.insert(0, str(Path(__file__).parent))
import site_pages

from hgogen.extras.page import mathml
from hgogen.registry import version as number

project, author, version = "hgogen", "the authors of hgogen", number()
extensions = ["myst_nb", "sphinx_design", "sphinxcontrib.bibtex"]
bibtex_bibfiles, bibtex_reference_style = ["references.bib"], "author_year"
exclude_patterns = ["**/.ipynb_checkpoints"]
myst_enable_extensions = ["colon_fence", "dollarmath", "attrs_inline"]
myst_heading_anchors = 4
nb_render_markdown_format = "myst"  # as a notebook has equations and tables
nb_execution_mode, nb_execution_raise_on_error, nb_execution_timeout = "force", True, 300
nb_execution_in_temp = True  # a tutorial writes files
smartquotes = False  # x' is a derivative, and --all an option
html_theme, html_title, html_show_sourcelink = "pydata_sphinx_theme", f"hgogen {version}", False
html_extra_path = [f"{site_pages.PAGES}/extra"]  # reports, which are pages already
html_static_path, html_css_files = ["_static"], ["site.css"]
html_search_scorer = str(Path(__file__).parent / "search_order.js")
html_sidebars = {"*": []}  # a page that has no pages below it
html_theme_options = {
    "pygments_light_style": "default",
    "pygments_dark_style": "github-dark",
    "navbar_align": "left",
    "show_prev_next": True,
    "secondary_sidebar_items": ["page-toc"],
    "footer_start": ["copyright"],
    "footer_end": [],
}
copyright = "the authors of hgogen, MIT licence"
html_math_renderer = "mathml"


def inline(translator: Any, node: Any) -> None:
    """Write an equation in a line of text."""
    translator.body.append(mathml(node.astext(), "inline"))
    raise SkipNode


def display(translator: Any, node: Any) -> None:
    """Write an equation of its own, each of its aligned rows in a line."""
    number_ = f'<span class="eqno">({node["number"]})</span>' if node.get("number") else ""
    rows = "".join(f"<div>{mathml(row)}</div>" for row in site_pages.rows(node.astext()))
    translator.body.append(f'<div class="math-block">{number_}{rows}</div>')
    raise SkipNode


def setup(app: Sphinx) -> None:
    """Add the renderer of equations, and the pages that are generated from the package."""
    app.add_html_math_renderer("mathml", (inline, None), (display, None))
    site_pages.write_all(Path(app.srcdir))
