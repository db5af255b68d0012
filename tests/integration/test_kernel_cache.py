"""Caches of built kernels that cannot be written, or that a process died of."""

import os
import subprocess
import sys
import tempfile
import warnings
from collections.abc import Iterator
from pathlib import Path

import pytest

import clsim
from clsim.opencl import kernel_cache as cache


@pytest.fixture
def fresh(monkeypatch: pytest.MonkeyPatch) -> Iterator[pytest.MonkeyPatch]:
    """The state of a process that has not looked yet; changes of the environment are undone."""
    pyopencl = pytest.importorskip("pyopencl")
    for name in ("POCL_CACHE_DIR", "XDG_CACHE_HOME", "PYOPENCL_NO_CACHE"):
        monkeypatch.setenv(name, "")
    monkeypatch.setattr(pyopencl, "_PYOPENCL_NO_CACHE", pyopencl._PYOPENCL_NO_CACHE)
    cache.prepare.cache_clear()
    yield monkeypatch
    cache.prepare.cache_clear()


@pytest.mark.skipif(sys.platform != "linux", reason="/proc takes no folders on Linux")
@pytest.mark.parametrize("variable", ["HOME", "XDG_CACHE_HOME", "POCL_CACHE_DIR"])
def test_a_cache_that_cannot_be_written_is_replaced(fresh: pytest.MonkeyPatch, variable: str) -> None:
    fresh.setenv(variable, "/proc")
    with pytest.warns(clsim.ClsimWarning, match=r"cannot be used: .*; kernels are built anew"):
        assert cache.prepare() == ""
    folder = cache.pocl_folder()
    assert folder.is_dir()
    assert folder.stat().st_mode & 0o77 == 0
    assert os.environ["POCL_CACHE_DIR"] == str(folder)
    assert os.environ["PYOPENCL_NO_CACHE"] == ("" if variable == "POCL_CACHE_DIR" else "1")
    cache.prepare.cache_clear()
    assert cache.prepare() == ""  # a process that it starts says nothing
    cache._remove(folder, os.getpid() + 1)
    assert folder.is_dir()
    cache._remove(folder, os.getpid())
    assert not folder.exists()


@pytest.mark.skipif(os.name == "nt", reason="PoCL has no such folder there")
def test_the_folder_that_all_users_share_is_not_used(fresh: pytest.MonkeyPatch) -> None:
    fresh.setenv("HOME", "")
    looked: list[Path] = []
    trouble = cache._trouble
    fresh.setattr(cache, "_trouble", lambda folder: looked.append(folder) or trouble(folder))
    with pytest.warns(clsim.ClsimWarning, match=r"HOME is not set, .*; kernels are built anew"):
        assert cache.prepare() == ""
    folder = cache.pocl_folder()
    assert folder.stat().st_mode & 0o77 == 0
    assert Path("/tmp/pocl") not in {parent for path in (folder, *looked) for parent in path.parents}
    cache._remove(folder, os.getpid())


@pytest.mark.parametrize("trouble", ["No space left on device", "it is mounted noexec"])
def test_without_any_folder_it_is_one_line(fresh: pytest.MonkeyPatch, error_of, trouble: str) -> None:
    fresh.setattr(cache, "_trouble", lambda folder: trouble)
    made: list[str] = []
    make = tempfile.mkdtemp
    fresh.setattr(tempfile, "mkdtemp", lambda **where: made.append(make(**where)) or made[-1])
    error = error_of("devices")
    assert error.startswith("OpenCL cannot be used: the cache of built kernels, ")
    assert f"cannot be used: {trouble}; no temporary folder can either: free some space" in error
    assert made
    assert not any(Path(folder).exists() for folder in made)


def test_a_full_folder_is_trouble(tmp_path: Path) -> None:
    resource = pytest.importorskip("resource")
    assert cache._trouble(tmp_path) == ""
    assert list(tmp_path.iterdir()) == []
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (2**16, hard))
    try:
        assert cache._trouble(tmp_path) == cache._TOO_LARGE
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
    (tmp_path / "file").touch()
    assert cache._trouble(tmp_path / "file" / "below") == "Not a directory"


@pytest.mark.skipif(sys.platform != "linux", reason="/proc takes no folders on Linux")
def test_a_read_only_home_has_its_device(device: None) -> None:
    environment = {k: v for k, v in os.environ.items() if k not in ("POCL_CACHE_DIR", "XDG_CACHE_HOME")}
    environment |= {"HOME": "/proc", "PYTHONPATH": os.pathsep.join(sys.path)}
    command = [sys.executable, "-m", "clsim", "devices"]
    done = subprocess.run(command, env=environment, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert done.stderr.count("\n") == 1
    assert "cannot be used" in done.stderr


def test_a_damaged_table_of_calls_is_done_without(fresh: pytest.MonkeyPatch, tmp_path: Path) -> None:
    invoker = pytest.importorskip("pyopencl.invoker")
    fresh.setenv("XDG_CACHE_HOME", str(tmp_path))
    name = Path(invoker.invoker_cache.filename).name if hasattr(invoker, "invoker_cache") else "table.sqlite"
    (tmp_path / "pytools").mkdir()
    (tmp_path / "pytools" / name).write_text("no database" * 100, "utf-8")
    fresh.delitem(sys.modules, "pyopencl.invoker")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ResourceWarning)
        assert not cache._pyopencl_cache_opens()
        assert cache.prepare() == ""
    assert os.environ["PYOPENCL_NO_CACHE"] == "1"


def test_a_program_that_a_process_died_of_is_another_one(fresh: pytest.MonkeyPatch, tmp_path: Path) -> None:
    fresh.setenv("POCL_CACHE_DIR", str(tmp_path))
    first = cache.Trial("tracks", "text", ["-DA=1"])
    with first.marked():
        marks = list((tmp_path / "clsim").iterdir())
        assert len(marks) == 1
        assert cache.Trial("tracks", "text", ["-DA=1"]).options == ["-DA=1"], "a process that lives has not died"
    assert list((tmp_path / "clsim").iterdir()) == []
    with pytest.raises(KeyboardInterrupt), first.marked():
        raise KeyboardInterrupt
    assert list((tmp_path / "clsim").iterdir()) == []
    marks[0].touch()  # what a killed process leaves: a mark that nobody locks
    assert cache.Trial("tracks", "text", ["-DA=2"]).options == ["-DA=2"]
    with pytest.warns(clsim.ClsimWarning, match=r"a process died while it built or first ran tracks\.cl"):
        assert cache.Trial("tracks", "text", ["-DA=1"]).options == ["-DA=1", "-DANEW=1"]
    assert cache.Trial("tracks", "text", ["-DA=1"]).options == ["-DA=1", "-DANEW=1"]  # and says nothing more


@pytest.mark.parametrize("kept", [0, 3, 63, 64, 1000, -1])
def test_what_is_cut_short_is_deleted(tmp_path: Path, kept: int) -> None:
    library = next(Path(sys.prefix).rglob("*.so"), None)
    if sys.platform != "linux" or library is None or sys.maxsize < 2**32:
        pytest.skip("no shared objects of 64 bit here")
    path = tmp_path / "AB" / "C" / "tracks" / "32-1-1" / "tracks.so"
    path.parent.mkdir(parents=True)
    path.write_bytes(library.read_bytes())
    assert cache._swept(tmp_path) == 0
    path.write_bytes(library.read_bytes()[:kept])
    assert cache._swept(tmp_path) == 1
    assert not path.exists()
    path.write_bytes(bytes(5000))
    assert cache._swept(tmp_path) == 1


class Event:
    def __init__(self) -> None:
        self.waited = False

    def wait(self) -> None:
        self.waited = True


def test_the_first_run_of_each_kind_is_waited_for(fresh: pytest.MonkeyPatch, tmp_path: Path) -> None:
    fresh.setenv("POCL_CACHE_DIR", str(tmp_path))
    seen = []

    def kernel(*arguments: object) -> Event:
        seen.append((arguments, len(list((tmp_path / "clsim").glob("*")))))
        return Event()

    tried = cache.TriedKernel(kernel, cache.Trial("tracks", "text", []))
    launches = [((64, 2), (32, 1)), ((96, 2), (32, 1)), ((128, 2), (32, 1)), ((64, 2), (1, 1)), ((128, 2), (32, 1))]
    assert [tried("queue", *launch, 7).waited for launch in launches] == [True, False, True, True, False]
    assert [arguments for arguments, _ in seen] == [("queue", *launch, 7) for launch in launches]
    assert [marks for _, marks in seen] == [1, 0, 1, 1, 0]


@pytest.mark.skipif(not hasattr(os, "geteuid"), reason="this system has no numbers of users")
@pytest.mark.parametrize(
    "how", ["written by all", "by all above", "by a group", "of somebody else", "of somebody else above", "by a link"]
)
def test_a_cache_of_others_is_not_used(fresh: pytest.MonkeyPatch, tmp_path: Path, how: str) -> None:
    folder = tmp_path / "above" / "kcache"
    folder.mkdir(parents=True)
    folder.chmod(0o700)
    above = folder.parent if "above" in how else folder
    if "somebody else" in how:
        if os.geteuid() != 0:
            pytest.skip("only root may give files away")
        os.chown(above, 65534, -1)
    elif how == "by a link":
        folder.chmod(0o777)
        folder = tmp_path / "link"
        folder.symlink_to(above)
    elif how == "by a group":
        if os.geteuid() != 0:
            pytest.skip("only root may give files away")
        os.chown(folder, -1, 65534)
        folder.chmod(0o770)
    else:
        above.chmod(0o777)
    fresh.setenv("POCL_CACHE_DIR", str(folder))
    with pytest.warns(
        clsim.ClsimWarning, match=r"cannot be used: .* (belongs to user|can write to) .*kernels are built anew"
    ):
        assert cache.prepare() == ""
    private = cache.pocl_folder()
    assert private != folder
    assert private.stat().st_mode & 0o77 == 0
    assert list(folder.iterdir()) == []
    cache._remove(private, os.getpid())


def test_a_cache_of_ones_own_is_used(fresh: pytest.MonkeyPatch, tmp_path: Path) -> None:
    (tmp_path / "sticky").mkdir()
    (tmp_path / "sticky").chmod(0o1777)  # as /tmp is
    fresh.setenv("POCL_CACHE_DIR", str(tmp_path / "sticky" / "mine"))
    assert cache.prepare() == ""
    assert cache.pocl_folder() == tmp_path / "sticky" / "mine"
