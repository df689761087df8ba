"""How the site is made: ``make docs``. Warnings are errors, and links within it are checked."""

from __future__ import annotations

import re
import sys
import warnings
from functools import partial
from html import unescape
from pathlib import Path
from typing import Any

import cg

# an editable install would run ninja for each name that is looked up; once is enough
for finder in sys.meta_path:
    if hasattr(finder, "_rebuild"):
        setattr(finder, "_rebuild", partial(lambda tree: tree, finder._rebuild()))  # noqa: B010

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE))

project = "crouch-grossman"
author = copyright = "The crouch-grossman developers"
version = release = cg.__version__

extensions = [
    "method_pages",
    "myst_parser",
    "numpydoc",
    "sphinx.ext.autodoc",
    "sphinx.ext.autosummary",
    "sphinx.ext.mathjax",
    "sphinx_copybutton",
    "sphinx_gallery.gen_gallery",
    "sphinx-mathjax-offline",
]
source_suffix = {".md": "markdown", ".rst": "restructuredtext"}
exclude_patterns = ["gallery", "sg_execution_times.rst", "examples_built/sg_execution_times.rst"]
suppress_warnings = ["myst.xref_missing.outside", "config.cache"]

myst_enable_extensions = ["deflist", "dollarmath", "attrs_inline"]
myst_heading_anchors = 4

autosummary_generate = True
autodoc_typehints = "none"  # docstrings say types in words
numpydoc_show_class_members = False
default_role = "py:obj"

sphinx_gallery_conf = {
    "examples_dirs": "gallery",
    "gallery_dirs": "examples_built",
    "filename_pattern": "/plot_",
    "ignore_pattern": r"^(?!plot_)",
    "download_all_examples": False,
    "show_signature": False,
    "min_reported_time": 1e9,
    "image_srcset": ["2x"],
}

html_theme = "furo"
html_title = "crouch-grossman"
html_static_path = ["_static"]
html_css_files = ["site.css"]
html_js_files = ["sort.js"]
html_show_sourcelink = False
html_search_scorer = str(HERE / "search_scorer.js")
html_favicon = "_static/favicon.svg"
templates_path = ["_templates"]
copybutton_exclude = ".linenos, .gp, .go"

warnings.filterwarnings("ignore", message="FigureCanvasAgg is non-interactive")


def _outside(app: Any, relative: Path, _: Any, content: list[str]) -> None:
    """Let pages that are read in the repository too point to files outside of the site."""
    content[0] = content[0].replace("](../CONTRIBUTING.md)", "](contributing.md)")


def _describe_thumbnails(app: Any, page: str, content: list[str]) -> None:
    """Give the pictures of the gallery the sentences that describe them as alternative text."""
    if page == "examples_built/index":
        described = re.compile(r'tooltip="(.*?)">.*?:alt:', re.DOTALL)
        text = content[0].replace("\\|", "|")
        content[0] = described.sub(lambda m: f"{m[0]} {unescape(m[1])}", text)


def _from_elsewhere(app: Any, what: str, name: str, member: Any, skip: bool, _: Any) -> bool | None:
    """Leave out what classes inherit from other packages, whose docstrings are no numpydoc."""
    package = (getattr(member, "__module__", None) or "").partition(".")[0]
    return True if package in {"diffrax", "equinox"} else None


def setup(app: Any) -> None:
    """Connect what is local to this site."""
    app.connect("include-read", _outside)
    app.connect("source-read", _describe_thumbnails)
    app.connect("autodoc-skip-member", _from_elsewhere)
