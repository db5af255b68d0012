"""A run on many processes: to the last bit that of one, whoever is killed and whoever goes on."""

import signal
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from killing import content
from late import installed
from made_clusters import Worker, made_cluster
from test_resume import SCENE, command, done

from clsim.cli import main
from clsim.workflow import workers as team

installed("distributed")
installed("zarr")
installed("xarray")

DEAF = '{ kind = "impulse-response", samples = [1e12], sampling_rate = 192e3 }'
LONG = SCENE % (1.9, 2)  # 20 chunks, receivers with and without ends that ring on


@pytest.fixture(scope="module")
def cluster(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[str, list[Worker]]]:
    """Start a scheduler and two workers, of which tests may kill the first."""
    with made_cluster(tmp_path_factory.mktemp("cluster"), 2) as made:
        yield made


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("scene") / "scene.toml"
    path.write_text(LONG, "utf-8")
    return path


@pytest.fixture(scope="module")
def whole(scene: Path, once: Callable[..., Any]) -> dict[str, bytes]:
    """All that a run of one process leaves."""

    def made() -> dict[str, bytes]:
        assert main(command(scene, scene.parent / "whole", "zarr")) == 0
        return content(scene.parent / "whole")

    return once("20 chunks by one process", made)


@pytest.mark.exhaustive
def test_either_goes_on_where_the_other_was_killed(scene: Path, whole: dict[str, bytes], cluster, killer, device):
    address, _ = cluster
    on_workers = ["--scheduler", address]
    for first, then in ((on_workers, []), ([], on_workers)):
        out = scene.parent / f"from-{len(first)}"
        assert killer.run(command(scene, out, "zarr", *first), out, event=2, of="journal.npz") == -signal.SIGKILL
        assert 0 < done(out) < 0.9 * 1.9 * 192e3
        assert [p.name for p in out.iterdir()] == [".partial"]  # nothing looks whole
        assert killer.run(command(scene, out, "zarr", "--resume", *then), out) == 0, killer.log
        assert content(out) == whole
        assert "clipped" in killer.log  # those before the kill are counted too


@pytest.mark.exhaustive
def test_a_killed_worker_changes_nothing(scene: Path, whole: dict[str, bytes], cluster, capsys, device) -> None:
    address, workers = cluster
    out, reached = scene.parent / "out", []

    def kill() -> None:
        while not done(out):
            time.sleep(0.005)
        workers[0].kill()  # kill -9, in the middle of a piece
        reached.append(done(out))

    watching = threading.Thread(target=kill)
    watching.start()
    assert main(command(scene, out, "zarr", "--scheduler", address)) == 0
    watching.join()
    assert 0 < reached[0] < 0.9 * 1.9 * 192e3
    assert content(out) == whole
    said = capsys.readouterr().err.splitlines()
    assert len(said) == 1
    assert "clipped" in said[0]


@pytest.mark.slow
def test_processes_of_this_machine_render_the_same(scene: Path, whole: dict[str, bytes], capfd, device) -> None:
    out = scene.parent / "local"
    assert main(command(scene, out, "zarr", "--workers", "2")) == 0
    assert content(out) == whole
    assert capfd.readouterr().err.count("\n") == 1


@pytest.mark.parametrize(
    ("more", "message"),
    [
        (["--scheduler", "tcp://127.0.0.1:9"], "--scheduler: tcp://127.0.0.1:9 cannot be reached"),
        (["--workers", "0"], "--workers: must be at least 1, but is 0"),
        (["--workers", "2", "--scheduler", "tcp://a:1"], "--workers: must be left out, because the scheduler has its own"),
        (["--workers", "2", "--store", "wav"], "--store: must be zarr for --workers, written by regions, but is wav"),
        (["--scheduler", "a", "--store", "hdf5"], "--store: must be zarr for --scheduler, written by regions, but is hdf5"),
    ],
)  # fmt: skip
def test_workers_that_cannot_be_had_are_one_line(scene: Path, error_of, monkeypatch, more: list[str], message: str):
    monkeypatch.setattr(team, "_REACH", 0.5)
    out = scene.parent / "none"
    assert error_of(*command(scene, out, "zarr", *more)).startswith(message)
    assert not out.exists(), "nothing was begun"


@pytest.mark.exhaustive
def test_what_a_worker_finds_wrong_is_said_as_by_one_process(scene: Path, cluster, capfd, device) -> None:
    loud = scene.with_name("loud.toml")
    text = LONG.replace("gain_db = 40.0", "gain_db = 200.0").replace('"chirp",', '"chirp", amplitude = 1e12,')
    for old, new in (
        ("adc_bits = 12, adc_full_scale = 0.25, ", ""),
        ('{ kind = "named", name = "MA40S4R" }', DEAF),
        ('name = "robot"', f'name = "robot"\ntransducer = {DEAF}'),
    ):
        assert old in text
        text = text.replace(old, new)
    loud.write_text(text, "utf-8")
    said = []
    for out, more in (("one", []), ("many", ["--scheduler", cluster[0]])):
        assert main(command(loud, scene.parent / out, "zarr", *more)) == 2
        said.append(capfd.readouterr().err.splitlines()[-1])  # after warnings of the amplitude
        assert not (scene.parent / out).exists()
    assert said[0].startswith("clsim: error: receivers: must receive what float32 holds, but of 'über/left' sample ")
    assert said[1] == said[0]
