"""The documentation site: ``python -m pip install '.[docs]' && python -m sphinx -W docs site``.

Pages are Markdown. What can be generated is: `_extensions/generated.py` puts keys, commands and what programs print and
draw where pages ask for it. `_extensions/mathml.py` sets formulas without a script: no page needs the network.
"""

import sys
import tomllib
from pathlib import Path

import farhorizon

sys.path.insert(0, str(Path(__file__).parent / "_extensions"))

URLS = tomllib.loads((Path(__file__).parents[1] / "pyproject.toml").read_text(encoding="utf-8"))["project"]["urls"]

project = "farhorizon"
author = "The farhorizon developers"
copyright = "the farhorizon developers, BSD-3-Clause"
version = release = farhorizon.__version__

extensions = [
    "sphinx.ext.autodoc",
    "sphinx.ext.autosummary",
    "numpydoc",
    "myst_parser",
    "sphinx_design",
    "sphinx_copybutton",
    "mathml",
    "generated",
    "mentions",
]
exclude_patterns = ["_extensions", "_templates", "generated"]
templates_path = ["_templates"]

myst_enable_extensions = ["attrs_block", "colon_fence", "deflist", "dollarmath"]
myst_heading_anchors = 3
highlight_language = "none"
copybutton_prompt_text = "$ "  # of a command and its output the command is copied

# Names in backticks in docstrings are links where there is a page of that name, code where there is none.
default_role = "py:obj"
autosummary_generate = True
autodoc_typehints = "none"
numpydoc_show_class_members = False  # the template lists them
numpydoc_xref_param_type = False

html_theme = "pydata_sphinx_theme"
html_title = "farhorizon"
html_baseurl = URLS["Documentation"]
html_static_path = ["_static"]
html_css_files = ["site.css"]
html_copy_source = False
html_show_sourcelink = False
html_theme_options = {
    "logo": {"text": f"farhorizon {release}"},
    "navbar_end": ["theme-switcher"],  # light and dark; the search is beside it
    "show_toc_level": 2,
    "navigation_with_keys": False,
    "show_prev_next": True,
    "footer_start": ["copyright"],
    "footer_end": [],
    "secondary_sidebar_items": ["page-toc"],
    "pygments_light_style": "a11y-high-contrast-light",
    "pygments_dark_style": "a11y-high-contrast-dark",
}
