"""Errors of ranges and positions estimated from a recording, against the ground truth."""

from clsim.score.position import GdopMap, PositionScore, gdop, gdop_map, position
from clsim.score.range_doppler import RangeDopplerMap, range_doppler
from clsim.score.ranging import RangingScore, ranging

__all__ = [
    "GdopMap",
    "PositionScore",
    "RangeDopplerMap",
    "RangingScore",
    "gdop",
    "gdop_map",
    "position",
    "range_doppler",
    "ranging",
]
