"""Measured processor time of the rendering methods, from `costs.toml`."""

from __future__ import annotations

import tomllib
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING

from clsim.errors import DeviceError
from clsim.opencl.device import find_device

if TYPE_CHECKING:
    from clsim.render.options import RenderOptions

FILE = Path(__file__).with_name("costs.toml")


@dataclass(frozen=True, slots=True)
class Costs:
    """Processor time, ns, and the speed of a GPU relative to a CPU; each entry is explained in `costs.toml`."""

    plain: float
    wide: float
    rest: float
    nodes: float
    envelope: float
    upsampled: float
    split: float
    planned: float
    branch: float
    function: float
    channel_path: float
    channel_function: float
    channel_point: float
    channel_nodes: float
    gpu: float


@cache
def measured_costs() -> Costs:
    """Return the costs of this installation."""
    content = tomllib.loads(FILE.read_text("utf-8"))
    return Costs(**content["nanoseconds"], **content["times"])


def on_gpu(options: RenderOptions) -> bool:
    """Test whether the device that is requested, or found, is a GPU."""
    try:
        return find_device(options.device)[0].kind == "GPU"
    except DeviceError:  # reported when it is needed
        return False
