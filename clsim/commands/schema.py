"""`clsim schema`: the JSON schema of scene files."""

from __future__ import annotations

import argparse
import json

from clsim.scene_file.scene import scene_schema


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of the command, which has none."""


def execute(options: argparse.Namespace) -> int:
    """Print it; return the exit status."""
    print(json.dumps(scene_schema(), indent=1))
    return 0
