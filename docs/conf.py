"""The documentation site: `make docs` builds it into build/site, and no warning is let pass."""

import sys
from importlib.metadata import version as version_of
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

project = "cogradar"
author = project_copyright = "the authors of cogradar"
version = release = version_of("cogradar")
extensions = ["myst_parser", "sphinx.ext.autodoc", "docs.generator.sphinx_extension"]
exclude_patterns = ["generator"]

myst_enable_extensions = ["dollarmath", "deflist"]
myst_heading_anchors = 3
myst_fence_as_directive = ["mermaid"]

autodoc_member_order = "bysource"
autodoc_typehints = "none"  # our docstrings say shapes and units
toc_object_entries = False

highlight_language = "none"

html_theme = "pydata_sphinx_theme"
html_title = "cogradar"
html_math_renderer = "mathml"
html_context = {"default_mode": "auto"}
html_copy_source = False
html_show_sphinx = False
html_theme_options = {
    "show_prev_next": True,
    "navigation_with_keys": False,
    "show_toc_level": 2,
    "secondary_sidebar_items": ["page-toc"],
}
html_static_path = ["_static"]
html_css_files = ["site.css"]
