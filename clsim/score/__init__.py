"""Errors of ranges and positions estimated from a recording, against the ground truth."""

from clsim.score.position import EchoBounds, GdopMap, PositionScore, echo_bounds, gdop, gdop_map, position
from clsim.score.range_doppler import EchoMap, RangeDopplerMap, echoes, range_doppler
from clsim.score.ranging import RangingScore, ranging

__all__ = [
    "EchoBounds",
    "EchoMap",
    "GdopMap",
    "PositionScore",
    "RangeDopplerMap",
    "RangingScore",
    "echo_bounds",
    "echoes",
    "gdop",
    "gdop_map",
    "position",
    "range_doppler",
    "ranging",
]
