"""Sphinx configuration of the documentation.

Build: `sphinx-build -W -b html docs docs/_build` (extra `docs`; the gallery needs Chromium).
"""

from __future__ import annotations

import sys
from pathlib import Path

import hplan

sys.path.insert(0, str(Path(__file__).parent))

project, author = "hplan", "The hplan authors"
version = release = hplan.__version__

extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx.ext.napoleon", "site_parts"]
exclude_patterns = ["_build", "pictures"]
myst_enable_extensions = ["dollarmath", "colon_fence"]
myst_heading_anchors = 4

#: Single backticks in a docstring mark code.
default_role = "code"

html_theme, html_title = "furo", "hplan"
html_math_renderer = "mathml"
html_static_path, html_css_files = ["site.css"], ["site.css"]
html_extra_path = ["generated/extra"]  # gallery pages and pictures
html_show_copyright = False
html_copy_source = False

# Docstrings are the only source of the reference: arguments, attributes, exceptions.
autodoc_member_order = "bysource"
autodoc_typehints_format = "short"
autodoc_inherit_docstrings = False
autodoc_type_aliases = {name: name for name in ("FloatArray", "IntArray", "BoolArray", "ArrayLike")}
python_use_unqualified_type_names = True
napoleon_google_docstring, napoleon_numpy_docstring = True, False
napoleon_use_ivar = True
