"""Results as people pick them up: tables, arrays with names and units, pictures, sound, notebooks, folders."""

import io
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import soundfile
from scene_texts import along, receiver_at, scene_text, source_at, tone_of

import clsim
from clsim.cli import main
from clsim.output.result_files import write_table

TIMES = np.array([0.0, 0.004, 0.009])

SCENE = scene_text(
    source_at("robot", tone_of(40e3, 0.01, fade=0.002), along((1, 1, 1), (1.02, 1, 1), 0.02)),
    receiver_at("über links", (3.0, 1.0, 2.0)),
    receiver_at("right", (3.0, 2.0, 2.0), transducer={"kind": "named", "name": "MA40S4R"}),
    render={"engine": "reference"},
)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the folder of a finished run."""
    place = tmp_path_factory.mktemp("results")
    (place / "scene.toml").write_text(SCENE, "utf-8")
    assert main(["run", str(place / "scene.toml"), "-o", str(place / "out"), "--no-plots"]) == 0
    return place / "out"


@pytest.fixture(scope="module")
def recording(folder: Path) -> clsim.Recording:
    return clsim.load_recording(folder, paths=True)


@pytest.fixture
def pyplot(monkeypatch: pytest.MonkeyPatch) -> Iterator[Any]:
    import matplotlib

    matplotlib.use("agg")
    from matplotlib import pyplot

    yield pyplot
    pyplot.close("all")


def test_what_was_written_is_loaded(folder: Path, recording: clsim.Recording) -> None:
    file = clsim.load_scene(folder / "scene.completed.toml")
    again = clsim.render(clsim.find_paths(file.scene, **file.paths), **file.render)
    np.testing.assert_array_equal(recording.samples, again.samples)
    assert (recording.receiver_names, recording.units) == (("über links", "right"), ("Pa", "V"))
    assert recording.sampling_rate == 192e3
    assert recording.carrier is None
    assert recording.paths is not None
    assert recording.paths.digest() == again.paths.digest()


def test_some_receivers_are_loaded_with_their_own_scene(folder: Path, recording: clsim.Recording) -> None:
    one = clsim.load_recording(folder, ["right"], paths=True)
    np.testing.assert_array_equal(one.samples, recording.samples[1:])
    assert one.paths is not None
    assert [end.name for end in one.paths.scene.receivers] == ["right"]
    assert clsim.load_recording(folder).paths is None


def test_what_is_no_result_is_refused(folder: Path, tmp_path: Path) -> None:
    with pytest.raises(clsim.InputError, match=r"folder: must hold the results of a finished"):
        clsim.load_recording(tmp_path)
    with pytest.raises(
        clsim.InputError, match=r'receivers: must be one of "über links", "right", but is .rigth.; did you mean "right"'
    ):
        clsim.load_recording(folder, ["rigth"])
    with pytest.raises(clsim.InputError, match=r"receivers: must be a list of names, but is 'right'"):
        clsim.load_recording(folder, "right")
    (tmp_path / "clsim.json").write_text("[]", "utf-8")
    with pytest.raises(clsim.InputError, match=r"^folder: must hold no clsim.json of others, but .*clsim.json cannot"):
        clsim.load_recording(tmp_path)


def test_a_dataset_has_names_units_and_times(recording: clsim.Recording) -> None:
    pytest.importorskip("xarray")
    found = recording.to_xarray()
    np.testing.assert_array_equal(found.sound.sel(receiver="right"), recording.samples[1])
    np.testing.assert_allclose(found.time, recording.times, rtol=1e-15)
    np.testing.assert_array_equal(found.position.sel(receiver="right"), [3.0, 2.0, 2.0])
    assert found.unit.values.tolist() == ["Pa", "V"]
    assert found.attrs["sampling_rate"] == 192e3


def test_paths_have_the_same_columns_everywhere(recording: clsim.Recording, tmp_path: Path) -> None:
    pandas = pytest.importorskip("pandas")
    pytest.importorskip("pyarrow")
    paths = recording.paths
    assert paths is not None
    frame, table = paths.to_dataframe(TIMES), paths.table(TIMES)
    write_table(table, tmp_path / "paths.parquet")
    parquet = pandas.read_parquet(tmp_path / "paths.parquet")
    assert list(frame.columns) == list(parquet.columns)
    for name in frame.columns:
        assert frame[name].tolist() == parquet[name].tolist(), name
    assert frame.attrs["units"]["delay"] == "s"
    assert frame.attrs["units"]["arrival_x"] == "1"
    direct = frame[(frame.receiver == "right") & frame.direct].set_index("times").delay
    np.testing.assert_allclose(direct[0.0], 6.0**0.5 / paths.scene.air.speed_of_sound, rtol=1.0 / 343.0)  # 1 m/s


def test_paths_and_ground_truth_have_named_dimensions(recording: clsim.Recording) -> None:
    pytest.importorskip("xarray")
    paths = recording.paths
    assert paths is not None
    found, table = paths.to_xarray(TIMES), paths.table(TIMES)
    assert dict(found.sizes) == {"path": len(paths), "times": 3, "axis": 3}
    floor = found.isel(path=(found.objects == "z_min") & (found.receiver == "right"))
    row = [table.name_objects(p) == "z_min" and r == 1 for p, r in enumerate(table.receiver)]
    np.testing.assert_array_equal(floor.delay, table.delay[row])
    np.testing.assert_array_equal(found.departure.sel(axis="y"), table.departure[..., 1])
    truth = clsim.direct_path(paths, TIMES).to_xarray()
    direct = found.isel(path=found.direct & (found.receiver == "right")).delay
    np.testing.assert_array_equal(truth.delay.sel(source="robot", receiver="right"), direct[0])
    assert [truth[name].attrs["units"] for name in ("times", "delay", "radial_speed")] == ["s", "s", "m/s"]
    assert truth.line_of_sight.all()
    rows = clsim.direct_path(paths, TIMES).to_dataframe()
    scalars = [name for name in truth.data_vars if truth[name].ndim == 3]
    vectors = [f"{name}_{axis}" for name in truth.data_vars if truth[name].ndim == 4 for axis in "xyz"]
    assert rows.columns.tolist() == ["times", "source", "receiver", *scalars, *vectors]
    assert rows.attrs["units"]["source_position_y"] == "m"
    assert rows.attrs["units"]["delay"] == "s"
    for name in scalars:
        np.testing.assert_array_equal(rows[name][rows.receiver == "right"], truth[name].sel(receiver="right")[0])
    np.testing.assert_array_equal(rows.times[rows.receiver == "right"], TIMES)


def test_pictures(recording: clsim.Recording, pyplot: Any) -> None:
    lines = recording.plot().axes
    assert [axes.get_title() for axes in lines] == ["über links", "right"]
    assert [axes.get_ylabel() for axes in lines] == ["Pa", "V"]
    drawn = lines[0].lines[0].get_ydata()
    assert (drawn.min(), drawn.max()) == (recording.samples[0].min(), recording.samples[0].max())
    level = recording.spectrogram("right", (30e3, 50e3)).axes[0].images[0]
    data = level.get_array()
    loudest = np.unravel_index(data.argmax(), data.shape)
    low, high = level.get_extent()[2:]
    assert abs(low + (loudest[0] + 0.5) / data.shape[0] * (high - low) - 40.0) < 0.5  # kHz


def test_waveforms_of_any_length_keep_their_peaks(pyplot: Any) -> None:
    samples = np.zeros((1, 1_000_003), dtype=np.float32)
    samples[0, [123_456, 1_000_002]] = 2.0, -3.0
    drawn = clsim.Recording(samples, 192e3, ("ear",), None, ()).plot().axes[0].lines[0].get_ydata()
    assert len(drawn) < 10_000
    assert (drawn.max(), drawn.min()) == (2.0, -3.0)


def test_notebooks_are_told_what_is_there(recording: clsim.Recording) -> None:
    paths = recording.paths
    assert paths is not None
    for text, parts in (
        (recording._repr_html_(), ["2 receivers", "192000 Hz", "über links", "right", "<td>V</td>"]),
        (paths._repr_html_(), [f"{len(paths)} intervals", "<td>1</td><td>12</td>"]),
        (paths.scene._repr_html_(), ["robot", "1.000, 1.000, 1.000", "4 x 3 x 2.5 m", "50 % relative humidity"]),
    ):
        assert text.startswith("<div>")
        for part in parts:
            assert part in text
    odd = clsim.Recording(np.zeros((1, 4), dtype=np.float32), 1e3, ("<script>",), None, ())
    assert "<script>" not in odd._repr_html_()


def test_pages_and_sound_in_notebooks(recording: clsim.Recording) -> None:
    pytest.importorskip("IPython", reason="IPython is not installed")
    paths = recording.paths
    assert paths is not None
    page, with_paths = paths.scene.show(frames=2).data, paths.show(frames=2).data
    for text in (page, with_paths):
        assert text.startswith("<div><iframe srcdoc=")
        assert "robot" in text
    assert "robot to right, direct" in with_paths
    assert "robot to right, direct" not in page
    sound = recording.play("right", slower=10)
    assert b"WAVE" in sound.data[:16]
    played, rate = soundfile.read(io.BytesIO(sound.data))
    assert rate == 19200
    heard = recording.samples[1].astype(float)
    np.testing.assert_allclose(played, heard * (played @ heard) / (heard @ heard), atol=2.0**-15)
    assert np.abs(played).max() > 0.5


@pytest.mark.parametrize(
    ("package", "extra", "use"),
    [
        ("pandas", "tables", lambda r: r.paths.to_dataframe(TIMES)),
        ("pandas", "tables", lambda r: clsim.direct_path(r.paths, TIMES).to_dataframe()),
        ("xarray", "tables", lambda r: r.paths.to_xarray(TIMES)),
        ("xarray", "tables", lambda r: r.to_xarray()),
        ("xarray", "tables", lambda r: clsim.direct_path(r.paths, TIMES).to_xarray()),
        ("IPython", "notebook", lambda r: r.play()),
        ("IPython", "notebook", lambda r: r.paths.scene.show()),
        ("IPython", "notebook", lambda r: r.paths.show()),
    ],
)
def test_missing_packages_are_answered_by_what_installs_them(recording, package, extra, use, monkeypatch) -> None:
    monkeypatch.setitem(sys.modules, package, None)
    with pytest.raises(clsim.InputError, match=rf"needs {package}: pip install 'clsim\[{extra}\]'$"):
        use(recording)


def test_what_cannot_be_played_or_found_is_refused(recording: clsim.Recording) -> None:
    envelope = clsim.Recording(np.zeros((1, 4), dtype=np.complex64), 6e3, ("a",), None, (), carrier=40e3)
    for use, message in (
        (lambda: recording.play(slower=100), r"slower: must leave a rate of 3000 to 384000 Hz.*it 1920 Hz"),
        (lambda: recording.play(slower=0.5), r"slower: must be .*1"),
        (lambda: envelope.play(), r"recording: must be sound to be played, but is the envelope about 40000 Hz"),
        (lambda: recording.spectrogram("left"), r'receiver: must be one of "über links", "right", but is .left.'),
        (lambda: recording.plot([2]), r"receiver: must be from 0 to 1, but is 2"),
        (lambda: recording.plot("left"), r"receiver: must be one of .*, but is 'left'"),
        (lambda: recording.spectrogram(0, (50e3, 30e3)), r"band\[1\]: must be above 50000 Hz, but is 30000 Hz"),
        (lambda: recording.spectrogram(0, (0.0, 1e9)), r"band\[1\]: must be at most 96000 Hz, but is 1e\+09 Hz"),
        (lambda: recording.save("a.mp3"), r"path: must end in \.wav, but is 'a\.mp3'"),
        (lambda: recording.save(""), r"path: must end in \.wav, but is ''"),
    ):
        with pytest.raises(clsim.InputError, match=message):
            use()
