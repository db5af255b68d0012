"""SOFA files that clsim writes, read by sofar, which knows the standard (AES69), and by netCDF4, which knows none of it.

What a file says is all that these tests use: the direct sound's delay follows from its positions and the speed of sound.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from late import installed

import clsim
from clsim.output.result_files import write_responses

sofar = installed("sofar", "sofar is not installed, with which clsim writes SOFA")

SPEED = 343.0
RATE = 48e3
SIZE = (5.0, 4.0, 3.0)
SOURCES = ((1.0, 1.5, 1.2), (4.1, 0.7, 2.0))
RECEIVERS = ((3.7, 2.9, 2.2), (1.02, 1.5, 1.21), (2.0, 3.3, 0.4))  # the second one 2 cm off, an arrival in sample 3.1
AIM = (0.0, 0.6, 0.8)
PEAK = 0.975  # of an impulse whose spectrum is 1 up to 0.95 of half the sampling rate and falls evenly up to half of it


@dataclass(frozen=True)
class Read:
    """What a file says, by whichever reader: a row for every measurement."""

    taps: np.ndarray  # (M, n)
    sampling_rate: float
    late: float  # samples by which the taps come later
    sources: np.ndarray  # (M, 3)
    receivers: np.ndarray  # (M, 3)
    views: np.ndarray  # (M, 3), of the sources


def by_sofar(path: Path) -> Read:
    sofa = sofar.read_sofa(str(path), verify=True, verbose=False)  # refuses what breaks the convention
    assert sofa.GLOBAL_SOFAConventions == "SingleRoomSRIR"
    assert sofa.SourcePosition_Type == sofa.ListenerPosition_Type == "cartesian"
    assert np.ndim(sofa.Data_SamplingRate) == 0
    np.testing.assert_array_equal(np.ravel(sofa.RoomCornerB), SIZE)
    return Read(
        sofa.Data_IR[:, 0], float(sofa.Data_SamplingRate), float(np.ravel(sofa.Data_Delay)[0]), sofa.SourcePosition,
        sofa.ListenerPosition, sofa.SourceView,
    )  # fmt: skip


def by_netcdf(path: Path) -> Read:
    netcdf = pytest.importorskip("netCDF4", reason="netCDF4 is not installed")
    with netcdf.Dataset(path) as file:
        file.set_auto_mask(False)
        told: dict[str, Any] = {name: variable[:] for name, variable in file.variables.items()}
        assert (file.Conventions, file.SOFAConventions, file.DataType) == ("SOFA", "SingleRoomSRIR", "FIR")
        assert file["Data.IR"].dimensions == ("M", "R", "N")
        assert file["Data.SamplingRate"].Units == "hertz"
        for name in ("SourcePosition", "ListenerPosition"):
            assert (file[name].Type, file[name].Units) == ("cartesian", "metre")
        np.testing.assert_array_equal(np.ravel(told["RoomCornerB"]), SIZE)
    return Read(
        told["Data.IR"][:, 0], float(told["Data.SamplingRate"][0]), float(told["Data.Delay"].ravel()[0]),
        told["SourcePosition"], told["ListenerPosition"], told["SourceView"],
    )  # fmt: skip


@pytest.fixture
def responses() -> clsim.ImpulseResponses:
    tone = clsim.Signal.tone(1e3, 0.01, RATE)
    sources = [
        clsim.Source(f"s{i}", tone, clsim.Trajectory.fixed(at), aim=AIM) for i, at in enumerate(SOURCES)
    ]  # fmt: skip
    ears = [clsim.Receiver(f"r{i}", clsim.Trajectory.fixed(at)) for i, at in enumerate(RECEIVERS)]
    room = clsim.Shoebox(SIZE, clsim.Material.from_reflection(0.9))
    scene = clsim.Scene(room, clsim.Air(speed_of_sound=SPEED, absorption=False), sources, ears)
    return clsim.impulse_responses(clsim.find_paths(scene, max_order=0), RATE, lead="keep", tail="off")


@pytest.mark.parametrize("reader", [by_sofar, by_netcdf])
def test_a_file_tells_where_when_and_how_loud(responses: clsim.ImpulseResponses, tmp_path: Path, reader: Any) -> None:
    """The peak of each measurement lies at the distance of its positions over the speed of sound.

    Within 0.01 sample, as clsim says, and 1e-4 of its height: as seen with 64 samples in place of one, by a parabola, whose
    error is of fourth order in 1/64 and so below 1e-5, and responses are said to be within -115 dB.
    """
    path = tmp_path / "responses.sofa"
    write_responses(responses, path)
    read = reader(path)
    assert responses.lead > 0  # so that it is seen to be told
    assert (read.sampling_rate, read.late) == (RATE, -responses.lead)
    np.testing.assert_array_equal(read.taps, responses.samples.reshape(read.taps.shape))
    np.testing.assert_array_equal(read.sources, np.repeat(SOURCES, len(RECEIVERS), axis=0))
    np.testing.assert_array_equal(read.receivers, np.tile(RECEIVERS, (len(SOURCES), 1)))
    np.testing.assert_allclose(read.views, np.tile(AIM, (len(read.taps), 1)), atol=4e-16)
    distances = np.linalg.norm(read.sources - read.receivers, axis=1)
    for taps, distance in zip(read.taps, distances, strict=True):
        at, height = peak(taps)
        assert (at + read.late) / read.sampling_rate == pytest.approx(distance / SPEED, abs=0.01 / RATE)
        assert height * distance == pytest.approx(PEAK, rel=1e-4)


def peak(taps: np.ndarray, finer: int = 64) -> tuple[float, float]:
    """Return the position of the maximum between samples, and its value."""
    padded = np.append(taps, np.zeros(len(taps)))  # twice as many, so that their number is even
    fine = np.fft.irfft(np.fft.rfft(padded), finer * len(padded)) * finer
    k = int(fine.argmax())
    a, b, c = fine[k - 1 : k + 2]
    off = 0.5 * (a - c) / (a - 2.0 * b + c)
    return (k + off) / finer, float(b - 0.25 * (a - c) * off)
