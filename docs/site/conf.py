"""How the documentation site is built: `make docs`.

Pages are docs/*.md, tutorials docs/tutorials/*.py, the reference is all of `clsim.__all__`.
"""

import os
import re
import sys
import warnings
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).parent))
import pages  # beside this file

import clsim

warnings.filterwarnings("ignore", message="FigureCanvasAgg is non-interactive")

project = "clsim"
author = "the clsim contributors"
version = release = clsim.__version__
html_title = f"clsim {release}"
extensions = [
    "myst_parser", "sphinx.ext.autodoc", "sphinx.ext.autosummary", "numpydoc", "sphinx_gallery.gen_gallery",
    "sphinx.ext.mathjax", "sphinx-mathjax-offline", "sphinx_design",
]  # fmt: skip
root_doc = "index"
exclude_patterns = ["site", "tutorials", "gallery/*.ipynb", "gallery/**/*.md5"]
myst_enable_extensions = ["dollarmath", "amsmath", "colon_fence"]
myst_heading_anchors = 3
highlight_language = "none"

html_theme = "furo"
templates_path = ["templates"]  # beside this file
html_show_sphinx = False
html_show_sourcelink = False
html_static_path: list[str] = []

autosummary_generate = True
autodoc_default_options = {"members": True, "show-inheritance": False}
autodoc_typehints = "none"  # the docstrings say it
autodoc_member_order = "bysource"
numpydoc_show_class_members = False
numpydoc_class_members_toctree = False

# Few tutorials need more than a second or two; one that fails ends the build.
sphinx_gallery_conf = {
    "examples_dirs": "tutorials",
    "gallery_dirs": "gallery",
    "filename_pattern": ".*",
    "within_subsection_order": "FileNameSortKey",
    "abort_on_example_error": True,
    "download_all_examples": False,
    "remove_config_comments": True,
    "show_memory": False,
    "show_signature": False,
    "write_computation_times": False,
    "matplotlib_animations": False,
    "plot_gallery": "True",
}


def _within_site(app: object, name: str, source: list[str]) -> None:
    """Tell files of the repository, which the site does not hold, by their names."""
    source[0] = re.sub(r"\[([^\]]+)\]\(\.\./([^)]+)\)", r"\1 (in the repository: `\2`)", source[0])


def setup(app: Any) -> None:
    """Write the pages that are made of the program itself before any is read."""
    app.connect("source-read", _within_site)
    pages.write_reference(Path(__file__).parents[1] / "api")
    pages.write_copies(Path(__file__).parents[1])
    pages.write_validation(Path(__file__).parents[1], os.environ.get("CLSIM_MEASURED"))
