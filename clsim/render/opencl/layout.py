"""Layout of the sum of paths on a device."""

from __future__ import annotations

from dataclasses import dataclass

from clsim.render.plan import BATCH

_TILE = 128  # paths whose branch signals stay in cache together


@dataclass(frozen=True, slots=True)
class Layout:
    """Layout of the sum of paths on a device: a subblock of samples over lanes of vectors, or over work-items."""

    lanes: int
    subblocks: int  # subblocks to a work-item, or to a group of them
    sparse_subblocks: int  # the same where signals pause
    nodes: int  # of a path, whose delays are solved side by side

    def constants(self, subblock: int, *, sparse: bool, fine: bool, oversampling: int) -> dict[str, int]:
        """Return the compile-time constants of the render kernel for a subblock's length."""
        workers = 1 if self.lanes > 1 else subblock
        return {
            "LANES": self.lanes,
            "VECTORS": subblock // (workers * self.lanes),
            "WORKERS": workers,
            "SPARSE": int(sparse),
            "FINE": int(fine),
            "OVERSAMPLING": oversampling,
            "BATCH": 1 if sparse else BATCH,
            "TILE": _TILE,
            "SUBBLOCKS": (self.sparse_subblocks if sparse else self.subblocks) * (32 // subblock),
        }


CPU_LAYOUT = Layout(lanes=8, subblocks=16, sparse_subblocks=48, nodes=4)
GPU_LAYOUT = Layout(lanes=1, subblocks=4, sparse_subblocks=16, nodes=1)
