"""Members of shards as a data set of PyTorch, with loaders in this process, forked and spawned."""

import os
import shutil
from pathlib import Path

import numpy as np
import pytest
from late import installed
from scene_texts import along, receiver_at, scene_text, shoebox_of, source_at, tone_of

import clsim
from clsim.cli import main
from clsim.opencl.device import list_devices
from clsim.study.shards import read_members, sound_of

torch = installed("torch")
installed("pyarrow")
installed("zarr")
installed("xarray")
pytestmark = [
    pytest.mark.filterwarnings("ignore:.*multi-threaded, use of fork:DeprecationWarning"),
    pytest.mark.filterwarnings("ignore:This DataLoader will create"),
]

SCENE = scene_text(
    source_at("talker", tone_of(1e3, 0.04, 16e3, fade=0.01), along((1, 1, 1), (2, 1, 1), 1.0)),
    receiver_at("ear", (3.0, 2.0, 1.5)),
    room=shoebox_of(reflection=0.8),
    rate=16e3,
    render={"duration": 0.05},
)
STUDY = """
format = 1
scene = "scene.toml"
keep = ["recording", "direct", "ground_truth"]
draws = 11
table_rate = 40.0
shards = { members = 3 }
[[vary]]
field = "sources[0].trajectory.start"
random = { inside = 0.4 }
"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    if not list_devices():
        pytest.skip("no OpenCL device on this machine")
    folder = tmp_path_factory.mktemp("members")
    (folder / "scene.toml").write_text(SCENE, "utf-8")
    (folder / "study.toml").write_text(STUDY, "utf-8")
    assert main(["study", str(folder / "study.toml"), "-o", str(folder / "out"), "--workers", "1"]) == 0
    return folder / "out"


def keys(dataset: object, **options: object) -> list[str]:
    from torch.utils.data import DataLoader

    return [key for batch in DataLoader(dataset, batch_size=2, **options) for key in batch["key"]]  # type: ignore[call-overload]


ALL = [f"m{k:06d}" for k in range(11)]


def test_members_are_what_shards_hold(folder: Path) -> None:
    found = list(clsim.torch.Members(folder, ("recording", "direct"), ("azimuth", "line_of_sight", "source")))
    wanted = [one for path in sorted((folder / "shards").glob("*.tar")) for one in read_members(path)]
    assert [one["key"] for one in found] == ALL
    for one, (labels, files) in zip(found, wanted, strict=True):
        assert np.array_equal(one["recording"].numpy(), sound_of(labels, files))
        assert np.array_equal(one["direct"].numpy(), sound_of(labels, files, "direct"))
        assert one["recording"].dtype == torch.float32
        assert np.array_equal(one["azimuth"].numpy(), labels["azimuth"])
        assert one["line_of_sight"].dtype == torch.bool
        assert one["source"] == ["talker"]


@pytest.mark.slow
@pytest.mark.parametrize(("method", "workers"), [(None, 0), ("fork", 2), ("spawn", 3), ("fork", 6)])
def test_each_member_comes_once_from_any_number_of_workers(folder: Path, method: str | None, workers: int) -> None:
    if method == "fork" and not hasattr(os, "fork"):
        pytest.skip("this system does not fork")
    dataset = clsim.torch.Members(folder)
    assert len(dataset) == 11
    assert sorted(keys(dataset, num_workers=workers, multiprocessing_context=method)) == ALL


def test_epochs_have_orders_of_their_own_which_a_seed_repeats(folder: Path) -> None:
    dataset, again = (clsim.torch.Members(folder, shuffle=True, seed=3) for _ in range(2))
    first, second = keys(dataset), keys(again)
    assert first == second != ALL
    again.set_epoch(1)
    assert sorted(keys(again)) == ALL
    assert keys(again) != first
    assert keys(clsim.torch.Members(folder, shuffle=True, seed=4)) != first


def test_what_is_wrong_is_told(folder: Path, tmp_path: Path) -> None:
    with pytest.raises(clsim.InputError, match=r"sounds\[0\]: must be one of"):
        clsim.torch.Members(folder, ("echo",))
    with pytest.raises(clsim.InputError, match=r"sounds: must be kept by the study, but m000000 has wav, direct\.wav"):
        next(iter(clsim.torch.Members(folder, ("noise",))))
    with pytest.raises(clsim.InputError, match="labels: must be columns of the shards, but m000000 has no 'colour'"):
        next(iter(clsim.torch.Members(folder, labels=("colour",))))
    copied = shutil.copytree(folder, tmp_path / "copied")
    tar = copied / "shards" / "shard-000002.tar"
    data = bytearray(tar.read_bytes())
    data[len(data) // 3] ^= 16
    tar.write_bytes(data)
    with pytest.raises(clsim.InputError, match=r"shard-000002\.tar"):
        list(clsim.torch.Members(copied))
    (copied / "shards" / "shard-000003.tar").write_bytes((copied / "shards" / "shard-000000.tar").read_bytes()[:0])
    tar.write_bytes((folder / "shards" / "shard-000002.tar").read_bytes())
    with pytest.raises(clsim.InputError, match=r"shard-000003\.tar"):
        list(clsim.torch.Members(copied))
