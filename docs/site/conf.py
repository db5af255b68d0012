"""How the documentation site is built: `make docs`.

Pages are docs/*.md, tutorials docs/tutorials/*.py, the reference is all of `clsim.__all__`.
"""

import os
import re
import shutil
import sys
import warnings
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).parent))
import media  # these two stand beside this file
import pages

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
html_copy_source = False
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


# What pages load of MathJax; the rest, for other inputs and outputs, is 20 MB.
MATHJAX = {"tex-chtml.js", "output/chtml", "input/tex"}


def _within_site(app: object, name: str, source: list[str]) -> None:
    """Name files of the repository, which the site does not hold, and embed viewers and sounds."""
    text = re.sub(r"\[([^\]]+)\]\(\.\./([^)]+)\)", r"\1 (in the repository: `\2`)", source[0])
    source[0] = media.embedded(text)


def _without_surplus(app: Any, error: Exception | None) -> None:
    """Delete the files of MathJax that no page loads."""
    folder = Path(app.outdir) / "_static" / "mathjax"
    for path in sorted([*folder.glob("*"), *folder.glob("*/*")], reverse=True):  # what a folder holds before it
        name = path.relative_to(folder).as_posix()
        if not any(name.startswith(kept) or kept.startswith(f"{name}/") for kept in MATHJAX):
            shutil.rmtree(path) if path.is_dir() else path.unlink()


def setup(app: Any) -> None:
    """Write the pages that are made of the program itself before any is read."""
    app.connect("source-read", _within_site)
    app.connect("build-finished", _without_surplus)
    pages.write_reference(Path(__file__).parents[1] / "api")
    pages.write_copies(Path(__file__).parents[1])
    pages.write_validation(Path(__file__).parents[1], os.environ.get("CLSIM_MEASURED"))
    media.write_media(Path(app.outdir) / "media")
