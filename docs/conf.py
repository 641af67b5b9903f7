"""Configuration of the documentation site: `sphinx-build -W docs site`."""

from importlib.metadata import version as version_of
from pathlib import Path
from runpy import run_path

import latex2mathml.converter
from docutils import nodes

project = "probedesign"
release = version = version_of("probedesign")
copyright = "the probedesign authors"

root_doc = "index"
extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx.ext.napoleon", "sphinx.ext.viewcode", "sphinx_design",
              "sphinx_gallery.gen_gallery"]  # fmt: skip
exclude_patterns = ["README.md", "paper.md", "**/*.ipynb", "**/.ipynb_checkpoints", "gallery/*"]
sphinx_gallery_conf = {"examples_dirs": "gallery", "gallery_dirs": "examples-gallery", "show_memory": False,
                       "min_reported_time": 1e9, "download_all_examples": False}  # fmt: skip
myst_heading_anchors = 3
myst_enable_extensions = ["colon_fence", "dollarmath"]
suppress_warnings = ["myst.header", "ref.python"]  # fields of several classes have one name

autodoc_member_order = "bysource"
autodoc_typehints = "signature"
autodoc_default_options = {"members": True}
napoleon_google_docstring = True
napoleon_use_rtype = False
napoleon_use_ivar = True

html_math_renderer = "mathml"
html_theme = "furo"
html_title = "probedesign"
html_static_path = ["static"]
html_css_files = ["site.css"]


def mathml(translator, node):
    """Write an equation as MathML, which browsers show without a script or a network."""
    inline = isinstance(node, nodes.math)
    markup = latex2mathml.converter.convert(node.astext(), display="inline" if inline else "block")
    translator.body.append(markup if inline else f'<div class="math">{markup}</div>')
    raise nodes.SkipNode


def setup(app):
    """Draw the pictures that follow from the program itself, and write equations as MathML."""
    app.add_html_math_renderer("mathml", (mathml, None), (mathml, None))

    def draw(_app):
        path = Path(app.srcdir) / "pictures/curved.py"
        run_path(str(path))["draw"]()

    app.connect("builder-inited", draw)
