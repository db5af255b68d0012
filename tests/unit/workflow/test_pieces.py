"""A run in pieces, in any order that workers may finish them in: the same samples, to the last bit."""

import pickle
import random
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from exhaustive import few
from late import installed
from test_toy_tail import Tail

import clsim
from clsim.output.stores import STORES, SoundStore, StoredSound
from clsim.render import planning
from clsim.render.plan import Plan
from clsim.render.render import Rendering
from clsim.workflow.checkpoint import Pieces
from clsim.workflow.pieces import Handed, PlanFile, check_worker, device_of, do_piece, versions

installed("zarr")
installed("xarray")
pytestmark = pytest.mark.filterwarnings("ignore:.* were clipped:clsim.ClsimWarning")

RATE = 48e3
CHUNK = 18_432


def made_plan(engine: str, seconds: float = 1.5) -> Plan:
    """Return a plan of four chunks if left so long, with receivers whose ends ring on and others between."""
    chirp = clsim.Signal.chirp(3e3, 5e3, seconds - 0.2, RATE, window="tukey")
    source = clsim.Source("s", chirp, clsim.Trajectory.line((1, 1, 1), (2, 1, 1), seconds + 0.5))
    ends = [
        None,
        clsim.Electronics(low_cut=2e3, high_cut=8e3, order=3, self_noise_db=20.0, seed=2, adc_bits=12, adc_full_scale=0.5),
        None,
        None,
        clsim.Electronics(low_cut=1e3, clock_ppm=30.0),
    ]  # fmt: skip
    receivers = [
        clsim.Receiver(f"r{i}", clsim.Trajectory.fixed((3.0, 0.5 + 0.4 * i, 2.0)), electronics=end)
        for i, end in enumerate(ends)
    ]
    room = clsim.Shoebox((4.0, 3.0, 2.5), clsim.Material.from_reflection(0.9))
    paths = clsim.find_paths(clsim.Scene(room, clsim.Air(), [source], receivers), 0)
    return clsim.plan_render(
        paths, RATE, engine=engine, chunk=CHUNK, responses="centre", interpolator=clsim.Bandlimited(-60.0)
    )


@cache
def rendered(engine: str) -> tuple[Plan, np.ndarray, Rendering]:
    """Return the plan, what one process makes of it, (5, n), and the rendering that is done with."""
    plan = made_plan(engine)
    rendering = Rendering(plan)
    return plan, np.concatenate([samples for _, samples in rendering.pieces()], axis=1), rendering


def store_in(folder: Path, plan: Plan) -> SoundStore:
    names = plan.tracks.receiver_names
    positions = np.zeros((len(names), 3))
    about = StoredSound(plan.channels, plan.units, positions, RATE, plan.samples, plan.chunk, "", clsim.__version__)
    store = STORES["zarr"](folder, about, names)
    store.create()
    return store


def samples_in(folder: Path) -> np.ndarray:
    import zarr

    return np.nan_to_num(
        zarr.open_group(folder / "recording.zarr", mode="r")["sound"][...]
    )  # also where it is not whole


def done_in_pieces(
    plan: Plan, folder: Path, chance: random.Random, begun: tuple[int, Any] = (0, {}), stop: int | None = None
) -> list[tuple[int, Any]]:
    """Do pieces at random, some of them twice; return what was whole behind each, until `stop` samples are."""
    handed = Handed.of(plan, store_in(folder, plan), 3)
    pieces = Pieces(handed, PlanFile.write(folder, handed), *begun)
    ready, whole = pieces.todo(), []
    while ready:
        number = ready.pop(chance.randrange(len(ready)))
        function, arguments = pieces.call(number)
        assert function is do_piece
        for _ in range(chance.randint(1, 2)):  # a worker that was taken for dead does it, too
            row = do_piece(*pickle.loads(pickle.dumps(arguments)), None)
        ready += pieces.settle(number, row["state"])
        whole.append(pieces.whole())
        if stop is not None and whole[-1][0] >= stop:
            break
    pieces.file.remove()
    assert not list(folder.glob(".*")), "nothing is left beside the store"
    return whole


@pytest.mark.parametrize("seed", few([0, 1]))
def test_any_order_gives_the_same_samples(engine: str, seed: int, tmp_path: Path) -> None:
    plan, wanted, rendering = rendered(engine)
    assert -(-plan.samples // plan.chunk) == 4
    assert 0 < rendering.clipped[1] < plan.samples / 2
    whole = done_in_pieces(plan, tmp_path, random.Random(seed))
    np.testing.assert_array_equal(samples_in(tmp_path), wanted)
    assert whole[-1][0] == plan.samples
    assert [done for done, _ in whole] == sorted(done for done, _ in whole)
    for name, value in rendering.state().items():
        np.testing.assert_array_equal(whole[-1][1][name], value)


def test_what_is_whole_is_enough_for_one_process_and_for_others(tmp_path: Path) -> None:
    plan, wanted, _ = rendered("reference")
    done, state = done_in_pieces(plan, tmp_path, random.Random(5), stop=2 * CHUNK)[-1]
    assert 2 * CHUNK <= done < plan.samples
    np.testing.assert_array_equal(samples_in(tmp_path)[:, :done], wanted[:, :done])
    alone = Rendering(plan)
    alone.restore(state)
    np.testing.assert_array_equal(np.concatenate([s for _, s in alone.pieces(done)], axis=1), wanted[:, done:])
    (tmp_path / "again").mkdir()
    done_in_pieces(plan, tmp_path / "again", random.Random(6), (done, state))
    np.testing.assert_array_equal(samples_in(tmp_path / "again")[:, done:], wanted[:, done:])


def test_a_contribution_that_remembers_is_done_in_order(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(planning, "BUILDERS", [*planning.BUILDERS, lambda plan: Tail(plan, 0.2)])
    plan = made_plan("reference", 1.2)
    wanted = np.concatenate([samples for _, samples in Rendering(plan).pieces()], axis=1)
    done_in_pieces(plan, tmp_path, random.Random(1))
    np.testing.assert_array_equal(samples_in(tmp_path), wanted)


def test_chunks_of_envelopes_are_made_once_whichever_pieces_they_are_for(tmp_path: Path, device: str) -> None:
    seconds = 25.0  # longer than a chunk of the envelopes
    source = clsim.Source("s", clsim.Signal.tone(1e4, seconds, RATE), clsim.Trajectory.line((1, 1, 1), (2, 1, 1), 26.0))
    end = clsim.Electronics(low_cut=2e3, self_noise_db=20.0)
    receivers = [
        clsim.Receiver(f"r{i}", clsim.Trajectory.fixed((3.0, 0.5 + 0.4 * i, 2.0)), electronics=e)
        for i, e in enumerate([end, None])
    ]
    room = clsim.Shoebox((4.0, 3.0, 2.5), clsim.Material.from_reflection(0.9))
    paths = clsim.find_paths(clsim.Scene(room, clsim.Air(), [source], receivers), 0)
    plan = clsim.plan_render(paths, RATE, chunk=8 * CHUNK, duration=seconds, responses="centre", narrowband=True)
    handed = Handed.of(plan, store_in(tmp_path, plan), 2)
    pieces = Pieces(handed, PlanFile.write(tmp_path, handed), 0, {})
    shared = [n for n in range(pieces.count) if pieces.piece(n).shared is not None]
    assert len(shared) == 2
    assert pieces.todo() == shared, "pressure waits for envelopes"
    wanted = np.concatenate([samples for _, samples in Rendering(plan).pieces()], axis=1)
    (tmp_path / "random").mkdir()
    done_in_pieces(plan, tmp_path / "random", random.Random(3))
    np.testing.assert_array_equal(samples_in(tmp_path / "random"), wanted)


def test_workers_that_would_render_otherwise_are_refused(tmp_path: Path) -> None:
    plan = made_plan("reference", 0.5)
    file = PlanFile.write(tmp_path, Handed.of(plan, store_in(tmp_path, plan), 2))
    here = device_of(plan)
    assert check_worker(file, here, versions()) == ("", False)
    other = versions() | {"clsim": "0.0.9"}
    text = f"must have clsim 0.0.9, with which the run was begun, but has {clsim.__version__}"
    assert check_worker(file, here, other) == (text, False)
    text = f"must render on Some GPU, with which the run was begun, but has {here}"
    assert check_worker(file, "Some GPU", versions()) == (text, False)
    elsewhere = PlanFile(str(tmp_path / "elsewhere" / ".partial" / "run.plan"), file.digest)
    text = f"must see {tmp_path / 'elsewhere'} under the same path, but does not"
    assert check_worker(elsewhere, here, versions()) == (text, False)


def test_a_worker_takes_no_other_plan_and_writes_nothing_once_the_run_is_over(tmp_path: Path) -> None:
    plan = made_plan("reference", 0.5)
    handed = Handed.of(plan, store_in(tmp_path, plan), 5)  # the first receiver's samples need no others
    file = PlanFile.write(tmp_path, handed)
    with pytest.raises(clsim.ClsimError, match="must hold the plan of this run, but holds another one"):
        PlanFile(file.path, "0" * 64).load()
    function, arguments = Pieces(handed, file, 0, {}).call(0)
    function(*arguments, None)
    before = samples_in(tmp_path)
    assert np.any(before[0])
    file.remove()
    store_in(tmp_path, plan)  # another run begins where it was
    with pytest.raises(clsim.ClsimError, match="the run is over"):
        function(*arguments, None)
    assert not np.any(samples_in(tmp_path))
