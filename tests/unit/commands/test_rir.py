"""`clsim rir` and the files that it writes."""

import re
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import soundfile
from scene_texts import along, receiver_at, scene_text, source_at, tone_of

import clsim
from clsim.cli import main
from clsim.output.result_files import write_responses
from clsim.scene_file import load_scene

SCENE = scene_text(
    source_at(
        "robot", tone_of(10e3, 0.5, 48e3, fade=0.005), along((1, 1, 1), (2, 1, 1), 1.0),
        directivity={"kind": "first-order", "weight": 0.5}, aim=(0, 1, 0),
    ),
    receiver_at("left/1", (3.0, 1.0, 2.0)),
    receiver_at("right", (3.0, 2.0, 2.0)),
    max_order=2,
    rate=48e3,
)  # fmt: skip


@pytest.fixture
def scene(tmp_path: Path) -> Path:
    path = tmp_path / "scene.toml"
    path.write_text(SCENE, "utf-8")
    return path


@pytest.fixture
def wanted(scene: Path) -> clsim.ImpulseResponses:
    file = load_scene(scene)
    paths = clsim.find_paths(file.scene, 2)
    return clsim.impulse_responses(paths, 48e3, at=0.5, band=(2e3, 20e3), tail="off")


IN_BAND = ["--at", "0.5", "--band", "2000", "20000"]
ASKED = [*IN_BAND, "--tail", "off"]


def test_wav(scene: Path, tmp_path: Path, capsys, wanted) -> None:
    out = tmp_path / "out"
    assert main(["rir", str(scene), "-o", str(out), *ASKED]) == 0
    printed = capsys.readouterr()
    assert printed.err == ""
    names = ["robot_left_1.wav", "robot_right.wav"]
    assert sorted(p.name for p in out.iterdir()) == names
    assert printed.out.splitlines() == [
        *(str(out / name) for name in names),
        f"{wanted.samples.shape[2]} samples at 48000 Hz, exact from 2000 to 20000 Hz",
        "sample 0 is time 0, that of the emission; the first arrival, robot at left/1, is at sample "
        f"{np.sqrt(3.25) / wanted.scene.air.speed_of_sound * 48e3:.1f}",
        'images leave some -2 dB of the reverberation (tail="auto" adds it)',
    ]
    for r, name in enumerate(names):
        samples, rate = soundfile.read(out / name, dtype="float32")
        assert rate == 48_000
        np.testing.assert_array_equal(samples, wanted.samples[0, r].astype(np.float32))


def test_npz(scene: Path, tmp_path: Path, wanted) -> None:
    out = tmp_path / "responses.npz"
    assert main(["rir", str(scene), "-o", str(out), *ASKED]) == 0
    with np.load(out) as file:
        np.testing.assert_array_equal(file["samples"], wanted.samples)
        assert (file["sampling_rate"], file["lead"], file["at"]) == (48e3, 0, 0.5)
        assert file["band"].tolist() == [2e3, 20e3]
        assert file["source_names"].tolist() == ["robot"]
        assert file["receiver_names"].tolist() == ["left/1", "right"]
        np.testing.assert_allclose(file["source_positions"], [[1.5, 1, 1]])
        np.testing.assert_allclose(file["receiver_positions"], [[3, 1, 2], [3, 2, 2]])
        np.testing.assert_allclose(np.abs(file["source_orientations"]), [[0, 0, 2**-0.5, 2**-0.5]])
        np.testing.assert_allclose(file["receiver_orientations"], [[0, 0, 0, 1]] * 2)


def test_sofa(scene: Path, tmp_path: Path, wanted) -> None:
    sofar = pytest.importorskip("sofar", reason="sofar is not installed")
    out = tmp_path / "responses.sofa"
    assert main(["rir", str(scene), "-o", str(out), *ASKED]) == 0
    sofa = sofar.read_sofa(str(out), verbose=False)
    sofa.verify()
    assert (sofa.GLOBAL_SOFAConventions, sofa.GLOBAL_RoomType) == ("SingleRoomSRIR", "shoebox")
    np.testing.assert_array_equal(sofa.Data_IR[:, 0], wanted.samples[0])
    assert sofa.Data_SamplingRate == 48e3
    np.testing.assert_array_equal(sofa.Data_Delay, 0.0)
    np.testing.assert_allclose(sofa.SourcePosition, [[1.5, 1, 1]] * 2)
    np.testing.assert_allclose(sofa.ListenerPosition, [[3, 1, 2], [3, 2, 2]])
    np.testing.assert_allclose(sofa.SourceView, [[0, 1, 0]] * 2, atol=1e-12)
    np.testing.assert_allclose(sofa.SourceUp, [[0, 0, 1]] * 2, atol=1e-12)
    np.testing.assert_allclose(sofa.ListenerView, [[1, 0, 0]] * 2, atol=1e-12)
    np.testing.assert_allclose(sofa.RoomCornerB, [[4, 3, 2.5]])
    assert pytest.approx(293.15) == sofa.RoomTemperature


def test_sofa_of_a_mesh_with_two_sources(tmp_path: Path) -> None:
    """Receivers run fastest; a lead that is kept is a negative delay; a room without a box has no corners."""
    sofar = pytest.importorskip("sofar", reason="sofar is not installed")
    room = clsim.MeshRoom.from_plan([(0, 0), (5, 0), (5, 4), (0, 4)], 3.0, clsim.Material.from_reflection(0.8))
    tone = clsim.Signal.tone(10e3, 0.01, 48e3)
    still = clsim.Trajectory.fixed
    sources = [clsim.Source(n, tone, still(p)) for n, p in (("a", (1, 1, 1)), ("b", (2, 3, 1)))]
    receivers = [clsim.Receiver(n, still(p)) for n, p in (("c", (1.05, 1, 1)), ("d", (4, 3, 2)), ("e", (3, 1, 2)))]
    scene = clsim.Scene(room, clsim.Air(), sources, receivers)
    found = clsim.impulse_responses(clsim.find_paths(scene, 1, engine="reference"), 48e3, lead="keep")
    assert found.lead > 0
    write_responses(found, tmp_path / "two.sofa")
    sofa = sofar.read_sofa(str(tmp_path / "two.sofa"), verbose=False)
    assert sofa.GLOBAL_RoomType == "reverberant"
    np.testing.assert_array_equal(sofa.Data_Delay, -found.lead)
    for row in range(6):
        s, r = divmod(row, 3)
        np.testing.assert_array_equal(sofa.Data_IR[row, 0], found.samples[s, r])
        np.testing.assert_allclose(sofa.SourcePosition[row], sources[s].trajectory.position(0.0))
        np.testing.assert_allclose(sofa.ListenerPosition[row], receivers[r].trajectory.position(0.0))


@pytest.mark.parametrize("form", ["wav", "npz", "sofa"])
def test_a_lead_is_cut_unless_it_is_asked_for(form: str, tmp_path: Path, capsys) -> None:
    if form == "sofa":
        pytest.importorskip("sofar", reason="sofar is not installed")
    scene = tmp_path / "scene.toml"
    scene.write_text(SCENE.replace("[3.0, 1.0, 2.0]", "[1.1, 1.0, 1.05]"), "utf-8")
    made = {}
    for lead in ("cut", "keep"):
        out = tmp_path / (lead if form == "wav" else f"{lead}.{form}")
        assert main(["rir", str(scene), "-o", str(out), *([] if lead == "cut" else ["--lead", "keep"])]) == 0
        made[lead], printed = _responses(out, form), capsys.readouterr()
        early = int(re.search(r"sample (\d+) is time 0", printed.out)[1])
        assert ("rings before time 0 is cut" in printed.out) == (lead == "cut")
        assert printed.err.count("warning") == (lead == "cut")
        assert early == 0 if lead == "cut" else early > 20
    np.testing.assert_array_equal(made["cut"], made["keep"][early:])


def _responses(path: Path, form: str) -> np.ndarray:
    """Return the taps of the first receiver."""
    if form == "wav":
        return soundfile.read(path / "robot_left_1.wav", dtype="float32")[0]
    if form == "npz":
        with np.load(path) as file:
            return file["samples"][0, 0]
    import sofar

    return sofar.read_sofa(str(path), verbose=False).Data_IR[0, 0]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--at", "1.5"], "--at: must lie within sources[0].trajectory, up to 1 s, but is 1.5 s"),
        (["--at", "nan"], "--at: must be finite, but is nan s"),
        (["--band", "0", "24000"], "--band: must be at most 22800 Hz, but is 24000 Hz"),
        (["--band", "nan", "20000"], "--band: must be finite, but is nan"),
        (["--tail-seed", "-1"], "--tail-seed: must be at least 0, but is -1"),
        (["--format", "npz"], "--output: must end in .npz, but is {out}"),
        (["-o", "responses.wav"], "--output: must be a folder for WAV files, but is responses.wav"),
        (["-o", "responses.MAT"], "--output: must be a folder for WAV files, but is responses.MAT"),
        (["-o", "responses.npz", "--format", "sofa"], "--output: must end in .sofa, but is responses.npz"),
    ],
)
def test_bad_arguments(scene: Path, tmp_path: Path, capsys, arguments: list[str], message: str) -> None:
    out = tmp_path / "out"
    assert main(["rir", str(scene), "-o", str(out), *arguments]) == 2
    printed = capsys.readouterr()
    assert printed.err == f"clsim: error: {message.format(out=out)}\n"
    assert printed.out == ""
    assert not out.exists()


def test_unwritable_and_missing(tmp_path: Path, scene: Path, capsys) -> None:
    (tmp_path / "file").write_text("x", "utf-8")
    assert main(["rir", str(scene), "-o", str(tmp_path / "file")]) == 2
    assert main(["rir", str(scene), "-o", str(tmp_path / "none" / "a.npz")]) == 2
    assert main(["rir", str(tmp_path / "none.toml"), "-o", str(tmp_path / "a.npz")]) == 2
    printed = capsys.readouterr()
    assert len(printed.err.splitlines()) == 3
    assert all(line.startswith("clsim: error: ") for line in printed.err.splitlines())
    with pytest.raises(clsim.InputError, match=r"^path: must end in \.npz or \.sofa"):
        write_responses(None, tmp_path / "a.txt")  # type: ignore[arg-type]


def test_a_tail_is_added_and_told(scene: Path, tmp_path: Path, capsys, wanted) -> None:
    out = tmp_path / "tail.npz"
    assert main(["rir", str(scene), "-o", str(out), *IN_BAND]) == 0
    told = capsys.readouterr().out.splitlines()[-1]
    assert re.match(r"source 0: diffuse tail of .*; without it -\d.\d dB of the energy is missing", told)
    with np.load(out) as made:
        samples = made["samples"]
    count = wanted.samples.shape[2]
    assert samples.shape[2] > 2 * count
    assert 0.0 < np.sum(samples[:, :, count:] ** 2) < np.sum(wanted.samples**2)


def test_options_of_the_tail_are_those_of_impulse_responses(tmp_path: Path, device: None) -> None:
    """In a room with an inner corner, where walls scatter by their limited size as well."""
    scene, plan = tmp_path / "scene.toml", "[[0, 0], [4, 0], [4, 1.5], [2, 1.5], [2, 3], [0, 3]]"
    box = 'kind = "shoebox"\nsize = [4.0, 3.0, 2.5]\nwalls = { reflection = 0.9 }'
    l_room = f'kind = "plan"\noutline = {plan}\nheight = 2.5\nmaterials = {{ default = {{ reflection = 0.9 }} }}'
    text = SCENE.replace(box, l_room).replace("[3.0, 1.0, 2.0]", "[1.0, 2.0, 2.0]")
    scene.write_text(text.replace("[3.0, 2.0, 2.0]", "[1.5, 2.5, 1.0]").replace("order = 2", "order = 0"), "utf-8")
    paths = clsim.find_paths(load_scene(scene).scene, 0)
    made = []
    for scattering in ("size", "material"):
        out = tmp_path / f"{scattering}.npz"
        asked = ["--tail-scattering", scattering, "--tail-seed", "3", "--band", "2000", "4000"]
        assert main(["rir", str(scene), "-o", str(out), *asked]) == 0
        with np.load(out) as file:
            made.append(file["samples"])
        by_hand = clsim.impulse_responses(paths, 48e3, band=(2e3, 4e3), tail_seed=3, tail_scattering=scattering)
        np.testing.assert_array_equal(made[-1], by_hand.samples)
    assert made[0].shape != made[1].shape or not np.array_equal(*made)


@pytest.mark.parametrize(("free", "told"), [(0, "disk full"), (2**30, "HDF error")])
def test_a_sofa_file_that_a_full_disk_cuts_short_is_told_as_that(free, told, scene, tmp_path, error_of, monkeypatch):
    sofar = pytest.importorskip("sofar")

    def short(*_: object) -> None:
        raise RuntimeError("HDF error")

    monkeypatch.setattr(sofar, "write_sofa", short)
    monkeypatch.setattr("shutil.disk_usage", lambda _: SimpleNamespace(free=free))
    out = tmp_path / "r.sofa"
    assert error_of("rir", scene, "-o", out, *ASKED) == f"cannot write {out}: {told}"
    assert not out.exists()
