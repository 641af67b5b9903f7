"""Configuration of the documentation site: `sphinx-build -W docs site`."""

from importlib.metadata import version as version_of
from pathlib import Path
from runpy import run_path

project = "probedesign"
release = version = version_of("probedesign")
copyright = "the probedesign authors"

root_doc = "index"
extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx.ext.napoleon", "sphinx.ext.viewcode"]
exclude_patterns = ["README.md", "**/*.ipynb", "**/.ipynb_checkpoints"]
myst_heading_anchors = 3
myst_enable_extensions = ["colon_fence", "dollarmath"]
suppress_warnings = ["myst.header"]

autodoc_member_order = "bysource"
autodoc_typehints = "signature"
autodoc_default_options = {"members": True}
napoleon_google_docstring = True
napoleon_use_rtype = False
napoleon_use_ivar = True

html_theme = "furo"
html_title = "probedesign"
html_static_path = ["static"]
html_css_files = ["math.css"]


def setup(app):
    """Draw the pictures that follow from the program itself."""

    def draw(_app):
        path = Path(app.srcdir) / "pictures/curved.py"
        run_path(str(path))["draw"]()

    app.connect("builder-inited", draw)
