"""Tables of air, walls, directivities and receivers for the device."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from clsim.numerics.quaternions import rotate
from clsim.numerics.spherical_harmonics import harmonic_norms
from clsim.paths.response import SceneResponse
from clsim.render.opencl.lookup_tables import HARMONIC, directivity_kind, directivity_table, wall_table
from clsim.scene.directivity.ambisonic import NORMALIZATIONS, Ambisonic
from clsim.scene.directivity.directivity import ChannelDirectivity
from clsim.scene.directivity.patterns import Omni

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable

    from numpy.typing import NDArray

    from clsim.arrays import Floats
    from clsim.render.plan import Plan
    from clsim.scene.ends import Receiver
    from clsim.scene.scene import Scene
    from clsim.tracks.basis import Basis

    Walls = NDArray[np.signedinteger[Any]]

_MOST_TERMS = 16
_AIR_ERROR = 1e-6  # of polynomials of what air does, relative to its absorption
_MOST_GAINS = 256  # of a path's channels, up to which the device makes nodes
VECTOR = 8  # numbers of a vector of gains or of frequencies in kernels
_NOTHING = np.zeros(VECTOR, dtype=np.float32)


@dataclass(frozen=True, slots=True, eq=False)
class Reception:
    """Directivities of receivers with equally many channels, as kernels take them."""

    channels: int
    kind: int  # of the tables
    projection: Any  # on the device, as in response.h
    tables: Any  # likewise
    table_of: NDArray[np.int32]  # (receivers of the scene,), bands from the first


class Environment:
    """Air, walls and directivities at the nodes of one source's basis, as the device takes them; see ``response.h``."""

    def __init__(
        self, scene: Scene, source: int, mach: float, basis: Basis, put: Callable[[NDArray[Any]], Any]
    ) -> None:
        c = scene.air.speed_of_sound
        self.count, self.parts = len(basis.nodes), basis.parts
        self._responses = SceneResponse(scene, source, basis.nodes)
        padding = -len(basis) % VECTOR if len(basis) > 1 else 0  # of gains, which stand side by side
        nepers, lead, self.air_terms = self._responses.nepers, np.zeros(1), 0
        if scene.air.dispersion:
            nepers, lead = air_polynomials(self._responses, mach)
            self.air_terms = len(nepers)
        air = [nepers, np.broadcast_to(lead / (2.0 * np.pi), nepers.shape)]
        self._scene, self._basis, self._put = scene, basis, put
        self.air = put(_flat([*air, basis.weight, basis.functions]))
        projection = [np.pad(p, ((0, 0), (0, padding))) for p in (basis.projection.T, basis.strengths[None])]
        directivities = [
            Omni() if isinstance(d, ChannelDirectivity) else d for d in (r.directivity for r in scene.receivers)
        ]
        receiver_kind = directivity_kind(directivities)
        self.source_kind = directivity_kind([scene.sources[source].directivity])
        source_beam = directivity_table(scene.sources[source].directivity, self.source_kind, basis.nodes, c, self.parts)
        kinds = list(dict.fromkeys(directivities))
        tables = [directivity_table(b, receiver_kind, basis.nodes, c, self.parts) for b in kinds]
        bands = len(tables[0]) // min(self.count, VECTOR)
        table_of = np.array([kinds.index(b) * bands for b in directivities], dtype=np.int32)
        beams = put(np.concatenate([*tables, _NOTHING]))
        self._receptions = {1: Reception(1, receiver_kind, put(_flat(projection)), beams, table_of)}
        materials, angular = scene.materials, self._responses.angular
        different = {id(m): m for m, turns in zip(materials, angular[:-1], strict=True) if turns}
        kind = {key: i for i, key in enumerate(different)}
        self._material_of = np.array([*(kind.get(id(m), -1) for m in materials), -1], dtype=np.int32)
        walls = [wall_table(m, basis.nodes, c, self.parts) for m in different.values()]
        flat = {"wall_tables": walls, "source_directivity": [source_beam]}
        self.tables = {name: put(np.concatenate([*parts, _NOTHING])) for name, parts in flat.items()}
        self.angular = 0

    def reception(self, channels: int) -> Reception:
        """Return the directivities of receivers with so many channels: plain ones, or ambisonic microphones."""
        if channels not in self._receptions:
            basis, order = self._basis, round(channels**0.5) - 1
            rows = basis.projection.astype(np.float32).ravel()
            sizes = np.repeat(basis.strengths, channels)
            projection = _flat([np.pad(part, (0, -part.size % VECTOR)) for part in (rows, sizes)])
            norms = [harmonic_norms(order) * Ambisonic(order, one).scale for one in NORMALIZATIONS]
            norms = [np.pad(norm, (0, -channels % VECTOR)) for norm in norms]
            bands = len(norms[0]) // min(self.count, VECTOR)
            table_of = [
                bands * NORMALIZATIONS.index(getattr(r.directivity, "normalization", NORMALIZATIONS[0]))
                for r in self._scene.receivers
            ]
            self._receptions[channels] = Reception(
                channels, HARMONIC, self._put(projection), self._put(_flat(norms)), np.array(table_of, dtype=np.int32)
            )
        return self._receptions[channels]

    def most_bounces(self, pairs: Iterable[Walls]) -> None:
        """Make room for the most walls that depend on the angle that any path of some pairs meets."""
        met = self._responses.angular
        self.angular = max((int(met[walls].sum(axis=1).max(initial=0)) for walls in pairs), default=0)

    def no_bounces(self, slots: int) -> tuple[NDArray[np.int32], NDArray[np.float32]]:
        """Return empty columns: material (at least 1, slots) and normal (at least 1, 3, slots) of every bounce."""
        count = max(self.angular, 1)
        return np.full((count, slots), -1, dtype=np.int32), np.zeros((count, 3, slots), dtype=np.float32)

    def reflection(self, walls: Walls) -> Floats:
        """Return the product of reflection factors of walls without angle dependence, (P, parts, nodes)."""
        product = self._responses.reflection(walls)
        return np.stack([product.real, product.imag][: self.parts], axis=1)

    def tables_of(self, walls: Walls) -> NDArray[np.int32]:
        """Return the tables of walls (...) that depend on the angle, -1 for others."""
        return np.asarray(self._material_of[walls])

    def bounces(self, walls: Walls) -> tuple[NDArray[np.int32], NDArray[np.float32]]:
        """Return material and normal of every bounce that depends on the angle, those of each path first."""
        wall_of, normal = self.no_bounces(len(walls))
        filled = np.zeros(len(walls), dtype=np.int64)
        for bounce, normals in self._responses.angular_bounces(walls):
            here = np.flatnonzero(self._responses.angular[walls[:, bounce]])
            wall_of[filled[here], here] = self._material_of[walls[here, bounce]]
            normal[filled[here], :, here] = normals[here]
            filled[here] += 1
        return wall_of, normal

    def bounces_of_sides(self, before: Walls, after: Walls) -> tuple[NDArray[np.int32], NDArray[np.float32]]:
        """Return material and normal of every bounce on the source's side, and -2 less those of the receiver's."""
        (first, one), (last, other) = (self.bounces(walls) for walls in (before, after))
        walls, normals = np.concatenate([first, np.where(last < 0, -1, -2 - last)]), np.concatenate([one, other])
        most = np.argsort(walls == -1, axis=0, kind="stable")[: len(first)]
        return np.take_along_axis(walls, most, axis=0), np.take_along_axis(normals, most[:, None], axis=0)


def has_directivity(plan: Plan, pair: int) -> bool:
    """Test whether programs of nodes have the directivity of the receiver of a scene's pair."""
    member, of_scene = plan.tracks.pairs[pair], plan.tracks.of_scene
    assert of_scene is not None
    directivity = of_scene.scene.receivers[member.receiver].directivity
    if not isinstance(directivity, ChannelDirectivity):
        return True
    gains = len(member.channels) * len(plan.source_filters[member.source].basis)
    return isinstance(directivity, Ambisonic) and gains <= _MOST_GAINS


def _flat(parts: Iterable[Floats]) -> NDArray[np.float32]:
    """Return arrays one after the other."""
    return np.concatenate([part.astype(np.float32).ravel() for part in parts])


def air_polynomials(at: SceneResponse, mach: float) -> tuple[Floats, Floats]:
    """Return absorption, 1/m, and lead, rad/m, as polynomials of what motion adds to frequencies; result (terms, F).

    absorption, lead: coefficients of powers of the ratio of the frequency on the way to that emitted, less 1.
    """
    low, high = -mach / (1.0 + mach), mach / (1.0 - mach)
    for terms in range(1, _MOST_TERMS + 1):
        places, between = (
            0.5 * (low + high) + 0.5 * (high - low) * np.cos(np.pi * (np.arange(n) + 0.5) / n)
            for n in (terms, 4 * terms)
        )
        powers = np.linalg.inv(np.vander(places, increasing=True))
        found, exact = ([powers @ x for x in at.air_at(1.0 + places[:, None])], at.air_at(1.0 + between[:, None]))
        made = [np.vander(between, terms, increasing=True) @ x for x in found]
        largest = np.abs(exact[0]).max()
        if max(np.abs(m - e).max() for m, e in zip(made, exact, strict=True)) <= _AIR_ERROR * largest:
            break
    return found[0], found[1]


# A receiver at a node, as in nodes/legs/static.h.
RECEIVER_NODE = np.dtype(
    [("position", "f8", 3), ("velocity", "f8", 3), ("axes", "f8", (2, 3)), ("clock_error", "f8"), ("clock_rate", "f8")]
)


def receiver_at(receiver: Receiver, times: Floats) -> NDArray[Any]:
    """Return position, velocity, axes and clock of a receiver, (times,)."""
    out = np.empty(len(times), dtype=RECEIVER_NODE)
    out["clock_error"] = receiver.clock_error(times)
    out["clock_rate"] = receiver.clock_rate
    true = times + out["clock_error"]
    out["position"], out["velocity"] = receiver.trajectory.position(true), receiver.trajectory.velocity(true)
    for i, axis in enumerate(np.eye(3)[:2]):
        out["axes"][:, i] = rotate(receiver.orientation(true), axis)
    return out
