"""Tables of sources' and receivers' parts, and of what moves in a room: bodies and scatterers."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import numpy as np
from pydantic import Field

from clsim.errors import InputError
from clsim.scene.body import Body
from clsim.scene.captured import SHAPES, UPS, captured_person
from clsim.scene.directivity.directivity import Directivity
from clsim.scene.directivity.head_related import HeadRelated, SphericalHead
from clsim.scene.directivity.patterns import Ambisonic, AxialDirectivity, FirstOrder, Omni, Piston
from clsim.scene.directivity.spherical_table import SphericalDirectivity
from clsim.scene.fluctuation import TargetFluctuation
from clsim.scene.motion.trajectory import Trajectory
from clsim.scene.people import hand, walking_person
from clsim.scene.room.mesh import MeshRoom
from clsim.scene.scatterer import Scatterer
from clsim.scene.signal.signal import Signal
from clsim.scene.transducer import Electronics, Transducer
from clsim.scene_file.model import Hold, Model, Numbers, Pair, Quaternion, Table, Vector, one_of, table
from clsim.scene_file.rooms import MaterialModel, MeshModel


class _OfChips(Table):
    kind: Literal["sequence"]
    sequence: Literal["mls", "gold"] = "mls"

    def parts(self, base: Path) -> dict[str, Any]:
        arguments = super().parts(base)
        return {"kind": arguments.pop("sequence"), **arguments}


class OmniModel(Table):
    """The same in every direction."""

    kind: Literal["omni"] = "omni"

    constructor = staticmethod(Omni)


class DirectivityTableModel(Table):
    """A file of values by angle and frequency: ``.csv``, ``.txt``, ``.npz`` or ``.mat``."""

    kind: Literal["table"]
    path: str
    phases_path: str | None = None
    scale: Literal["linear", "db"] | None = None
    variable: str | None = None
    angle: str | None = None
    frequency: str | None = None
    values: str | None = None
    angle_unit: Literal["degree", "radian"] | None = None
    rear: Literal["hold", "mirror", "zero"] | None = None
    side: Literal["positive", "negative", "mean"] | None = None
    outside: Hold = None
    relative_to_axis: bool = False

    def build(self, base: Path = Path()) -> Directivity:
        path = base / self.path
        options = self.model_dump(include={"rear", "side", "outside", "relative_to_axis"}) | {"name": path.stem}
        layout = self.model_dump(include={"variable", "angle", "frequency", "values", "angle_unit"}, exclude_none=True)
        suffix = path.suffix.lower()
        if suffix in (".csv", ".txt"):
            for name in layout:
                problem = f"must be left out for text files, whose layout is fixed, but is {layout[name]!r}"
                raise InputError(name, problem)
            phases = None if self.phases_path is None else base / self.phases_path
            return AxialDirectivity.from_csv(path, phases, self.scale or "db", **options)
        if suffix not in (".npz", ".mat"):
            raise InputError("path", f"must end in .csv, .txt, .npz or .mat, but is {self.path!r:.80}")
        if self.phases_path is not None:
            raise InputError("phases_path", f"must be left out for {suffix} files, which can hold complex values")
        if suffix == ".npz" and self.variable is not None:
            problem = f"must be left out for .npz files, which hold no structs, but is {self.variable!r}"
            raise InputError("variable", problem)
        read = AxialDirectivity.from_npz if suffix == ".npz" else AxialDirectivity.from_mat
        return read(path, self.scale, **layout, **options)


class _File(Table):
    path: str
    outside: Hold = None

    def parts(self, base: Path) -> dict[str, Any]:
        return super().parts(base) | {"name": Path(self.path).stem}


class SofaModel(_File):
    """A SOFA file."""

    kind: Literal["sofa"]
    measurement: int = 0
    relative_to_axis: bool = False

    constructor = staticmethod(SphericalDirectivity.from_sofa)


class HeadModel(_File):
    """A SOFA file of head-related responses."""

    kind: Literal["head"]

    constructor = staticmethod(HeadRelated.from_sofa)


class _ResponseTable(Table):
    kind: Literal["table"]
    frequencies: list[float]
    magnitudes: list[float]
    phases: list[float] | None = None
    outside: Literal["zero", "hold"] | None = None

    def build(self, base: Path = Path()) -> Transducer:
        values: Any = np.array(self.magnitudes)
        if self.phases is not None:
            if len(self.phases) != len(values):
                raise InputError("phases", f"must be one per magnitude, {len(values)}, but are {len(self.phases)}")
            values = values * np.exp(1j * np.array(self.phases))
        try:
            return Transducer.from_table(self.frequencies, values, self.outside)
        except InputError as error:
            raise InputError(error.field.replace("values", "magnitudes"), error.problem) from error


if TYPE_CHECKING:
    SignalModel = Table
    TrajectoryModel = Table
    DirectivityModel = Table
    TransducerModel = Table
    ElectronicsModel = Table
else:
    PULSES = (
        table("tone", Signal.tone),
        table("chirp", Signal.chirp, method=Literal["linear", "exponential"], window=Literal["none", "tukey", "hann"]),
        table("noise", Signal.noise),
        table("", Signal.sequence, name="_Sequence", base=_OfChips),
        table("wav", Signal.from_wav),
    )
    SignalModel = one_of(*PULSES, table("pulses", Signal.pulses, pulse=one_of(*PULSES)))
    TrajectoryModel = one_of(
        table("fixed", Trajectory.fixed, orientation=Quaternion | None),
        table("line", Trajectory.line),
        table("circle", Trajectory.circle),
        table("swing", Trajectory.swing, angles=Numbers, times=Numbers),
        table(
            "waypoints", Trajectory.waypoints, times=Numbers, positions=list[Vector],
            orientations=list[Quaternion] | None,
        ),
        table(
            "file", Trajectory.from_file, format=(Literal["tum", "euroc", "csv", "rosbag"], ...), rotate=Quaternion,
            columns=dict[str, str] | None,
            repair=list[Literal["times", "gaps", "nan", "jumps"]],
        ),
    )  # fmt: skip
    DirectivityModel = one_of(
        OmniModel,
        table("first-order", FirstOrder),
        table("piston", Piston),
        table("named", Directivity.named, outside=Hold),
        DirectivityTableModel,
        SofaModel,
        table("ambisonic", Ambisonic, normalization=Literal["SN3D", "N3D"]),
        HeadModel,
        table("spherical-head", SphericalHead),
    )
    _unnamed = partial(table, without="name")
    TransducerModel = one_of(
        table("named", Transducer.named, name="_NamedTransducer"),
        _unnamed("resonance", Transducer.resonance),
        _ResponseTable,
        _unnamed("impulse-response", Transducer.from_impulse_response, samples=Numbers),
        _unnamed("wav", Transducer.from_wav, name="_ImpulseResponseFile"),
    )
    ElectronicsModel = table("", Electronics, name="ElectronicsModel")
    ElectronicsModel.__doc__ = "Arguments of `Electronics`."


Corners = Annotated[list[int], Field(min_length=3, max_length=3)]


class _Body(Table):
    name: str
    trajectory: TrajectoryModel

    constructor = Body


class _Mesh(_Body):
    kind: Literal["mesh"]
    mesh: MeshModel


class _Faces(_Body):
    kind: Literal["faces"]
    vertices: list[Vector]
    triangles: list[Corners]
    material: MaterialModel

    def parts(self, base: Path) -> dict[str, Any]:
        arguments = super().parts(base)
        faces = [arguments.pop(name) for name in ("vertices", "triangles", "material")]
        if not self.triangles:
            raise InputError("triangles", "must hold at least one, but is empty")
        vertices = np.array(faces[0], dtype=np.float64).reshape(-1, 3)
        return arguments | {"mesh": MeshRoom(vertices, np.array(faces[1]), faces[2])}


class _Segment(Model):
    start: str
    end: str
    radius: float


class _Captured(Table):
    readers = {"segments": lambda given: None if given is None else [(s.start, s.end, s.radius) for s in given]}


if TYPE_CHECKING:
    BodyModel = Table
    ScattererModel = Table
else:
    BodyModel = one_of(table("box", Body.box, base=_Body, material=MaterialModel), _Mesh, _Faces)

    class _Scatterer(Table):
        name: str
        trajectory: TrajectoryModel
        fluctuation: table("", TargetFluctuation, name="_Fluctuation") | None = None

    _scatterer = partial(table, base=_Scatterer)
    ScattererModel = one_of(
        _scatterer("point", Scatterer.point),
        _scatterer("sphere", Scatterer.sphere, model=Literal["series", "geometrical", "outline"]),
        _scatterer("ellipsoid", Scatterer.ellipsoid),
        _scatterer("capsule", Scatterer.capsule),
        table("person", walking_person, trajectory=TrajectoryModel),
        table(
            "captured-person", captured_person, base=_Captured, segments=list[_Segment] | None, shape=Literal[SHAPES],
            up=Literal[UPS] | None, rotate=Quaternion,
        ),
        table("hand", hand, trajectory=TrajectoryModel, opening=float | list[Pair]),
    )  # fmt: skip
