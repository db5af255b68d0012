"""Batches: the bits of single calls for any number of processes, order, laziness, errors by index, nothing left behind."""

import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from killing import living

import clsim

RATE = 48e3


def scene(number: int, order: float = 0.8) -> clsim.Scene:
    """Make a room with two receivers and a source that moves from another place by number."""
    room = clsim.Shoebox((6.0, 5.0, 2.5), clsim.Material.from_reflection(order))
    chirp = clsim.Signal.chirp(2e3, 9e3, duration=0.02, sampling_rate=RATE, window="hann")
    begin = (1.0 + 0.1 * number, 1.0, 1.0)
    way = clsim.Trajectory.line(begin, (begin[0] + 0.5, 1.2, 1.0), 1.0)
    receivers = [clsim.Receiver(f"r{k}", clsim.Trajectory.fixed((4.0, 1.0 + k, 1.5))) for k in range(2)]
    return clsim.Scene(room, clsim.Air(), [clsim.Source("s", chirp, way)], receivers)


def single(number: int) -> clsim.Recording:
    return clsim.render(clsim.find_paths(scene(number), 2), RATE, duration=0.05)


@pytest.mark.parametrize("workers", [1, 2])
def test_a_batch_has_the_bits_and_the_order_of_single_calls(workers: int, device: None) -> None:
    found = list(clsim.render_batch(map(scene, range(7)), RATE, 2, workers=workers, truth_rate=50.0, duration=0.05))
    assert [one.index for one in found] == list(range(7))
    for one in found:
        wanted = single(one.index)
        assert wanted.paths is not None
        assert one.recording.samples.tobytes() == wanted.samples.tobytes()
        assert one.recording.notes == wanted.notes
        assert not one.recording.samples.flags.writeable
        truth = clsim.direct_path(wanted.paths, [0.0, 0.02, 0.04])
        assert np.array_equal(one.truth.times, truth.times)
        assert np.array_equal(one.truth.delay, truth.delay)
    assert len({one.recording.samples.tobytes() for one in found}) == 7


@pytest.mark.parametrize("workers", [1, 2])
def test_no_scenes_are_no_recordings(workers: int) -> None:
    assert list(clsim.render_batch([], RATE, 1, workers=workers)) == []


@pytest.mark.parametrize(("workers", "ahead"), [(1, 1), (2, 4)])
def test_scenes_are_taken_as_they_are_needed(workers: int, ahead: int, device: None) -> None:
    taken = []

    def endless() -> Iterator[clsim.Scene]:
        number = 0
        while True:
            taken.append(number)
            yield scene(number)
            number += 1

    batch = clsim.render_batch(endless(), RATE, 1, workers=workers, duration=0.03)
    assert taken == []
    for count in range(1, 4):
        assert next(batch).index == count - 1
        assert len(taken) <= count + ahead
    batch.close()  # type: ignore[attr-defined]


@pytest.mark.parametrize("workers", [1, 2])
def test_an_error_names_the_scene_after_those_before_it(workers: int, device: None) -> None:
    scenes = [scene(0), scene(1), scene(2, 0.9), scene(3)]
    late = clsim.Source("late", scenes[2].sources[0].signal, clsim.Trajectory.fixed((1.0, 1.0, 1.0)), start=9.0)
    scenes[2] = clsim.Scene(scenes[2].room, scenes[2].air, [late], scenes[2].receivers)
    high = clsim.Source("high", clsim.Signal.tone(40e3, 0.01, 192e3), clsim.Trajectory.fixed((1.0, 1.0, 1.0)))
    scenes[3] = clsim.Scene(scenes[3].room, scenes[3].air, [high], scenes[3].receivers)
    batch = clsim.render_batch(scenes, RATE, 1, workers=workers, duration=0.03)
    assert [next(batch).index for _ in range(3)] == [0, 1, 2]
    with pytest.raises(clsim.InputError, match=r"^scenes\[3\]\.") as caught:
        next(batch)
    assert "frequency" in str(caught.value)
    assert list(batch) == []


@pytest.mark.parametrize("workers", [1, 2])
def test_what_is_no_scene_is_refused_by_its_place(workers: int, device: None) -> None:
    batch = clsim.render_batch([scene(0), "room"], RATE, 1, workers=workers, duration=0.03)  # type: ignore[list-item]
    with pytest.raises(clsim.InputError, match=r"scenes\[1\]: must be a Scene, but is 'room'"):
        list(batch)


@pytest.mark.parametrize("workers", [1, 2])
def test_warnings_name_the_scene(workers: int, device: None) -> None:
    noisy = scene(1)
    click = clsim.Signal.from_array(np.eye(1, 64)[0], sampling_rate=RATE)
    noisy = clsim.Scene(noisy.room, noisy.air, [clsim.Source("s", click, noisy.sources[0].trajectory)], noisy.receivers)
    with pytest.warns(clsim.ClsimWarning, match=r"^scenes\[1\]: "):
        list(clsim.render_batch([scene(0), noisy], RATE, 0, workers=workers, duration=0.03))


def test_options_are_checked_before_the_first_scene() -> None:
    for name, value in (("workers", 0), ("truth_rate", 0.0), ("duration", -1.0), ("engine", "fast")):
        with pytest.raises(clsim.InputError, match=f"^{name}"):
            clsim.render_batch([], RATE, 1, **{name: value})
    with pytest.raises(clsim.InputError, match=r"^finder"):
        clsim.render_batch([], RATE, 1, paths={"finder": "luck"})
    with pytest.raises(clsim.InputError, match=r"^scenes: must be an iterable"):
        clsim.render_batch(5, RATE, 1)
    with pytest.raises(TypeError, match=r"^render_batch\(\) got an unexpected keyword argument 'durtion'"):
        clsim.render_batch([], RATE, 1, durtion=1.0)


SCRIPT = """
import sys
import clsim
sys.path.insert(0, {tests!r})
import test_batch

if __name__ == "__main__":
    import itertools
    for one in clsim.render_batch(map(test_batch.scene, itertools.count()), 48e3, 1, workers=2, duration=0.03):
        print(one.index, flush=True)
"""


@pytest.mark.skipif(sys.platform != "linux", reason="/proc tells of a group's processes on Linux")
def test_an_interrupt_leaves_no_process(tmp_path: Path, device: None) -> None:
    script = tmp_path / "endless.py"
    script.write_text(SCRIPT.format(tests=str(Path(__file__).parent)), "utf-8")
    line, environment = [sys.executable, str(script)], os.environ | {"PYTHONPATH": os.pathsep.join(sys.path)}
    with subprocess.Popen(
        line, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, start_new_session=True, env=environment
    ) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == "0\n"
        assert len(living(process.pid)) > 2
        os.killpg(process.pid, signal.SIGINT)
        _, err = process.communicate(timeout=60)
    assert process.returncode != 0
    assert "KeyboardInterrupt" in err
    until = time.monotonic() + 10.0
    while living(process.pid) and time.monotonic() < until:
        time.sleep(0.1)
    assert living(process.pid) == []
