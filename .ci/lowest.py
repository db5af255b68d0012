"""Prints the oldest versions that the requirements allow, a line each, as `pip install --requirement` takes them.

A lower bound that cannot be installed beside the others, or with which a scene does not run, is found by trying it.
"""

import re
import sys
import tomllib
from pathlib import Path

project = tomllib.loads((Path(__file__).parents[1] / "pyproject.toml").read_text("utf-8"))["project"]
needed = [*project["dependencies"], *project["optional-dependencies"]["pictures"]]
for requirement in needed:
    name, bound, marker = re.fullmatch(r"([\w.-]+)>=([\w.]+)(;.*)?", requirement.replace("; ", ";")).groups()
    sys.stdout.write(f"{name}=={bound}{marker or ''}\n")
