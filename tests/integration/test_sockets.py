"""Whoever else uses the machine can send nothing to workers: nothing listens, or it asks for a certificate."""

import os
import shutil
import socket
import subprocess
import sys
import time
from pathlib import Path

import pytest
from killing import content
from late import installed
from made_clusters import made_cluster
from made_studies import ENVIRONMENT, runs, write, write_scene
from made_tasks import MadeTasks, listening, tree
from test_resume import SCENE, command

from clsim.cli import main
from clsim.errors import ClsimWarning
from clsim.workflow.processes import Dispatch, local_team
from clsim.workflow.workers import Workers

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="/proc tells on Linux who listens")
CONNECT = "import os, socket, sys; os.setuid(65534); socket.socket(socket.AF_UNIX).connect(sys.argv[1])"


ATTACK = """
import os, sys
from distributed import Client
with Client(sys.argv[1], timeout=2, set_as_default=False) as client:
    print("runs programs as user", client.run_on_scheduler(os.getuid), flush=True)
    os._exit(0)
"""


def attacked(port: int) -> str:
    """Return the answer of a Dask scheduler at a port to a program from a stranger; "" if there is none."""
    line = [sys.executable, "-c", ATTACK, f"tcp://127.0.0.1:{port}"]
    try:
        return subprocess.run(line, capture_output=True, text=True, timeout=20).stdout.strip()
    except subprocess.TimeoutExpired:  # a client that finds no way to speak
        return ""


def answers(port: int) -> bytes:
    """Return the answer at a port to a client that connects and sends an HTTP request."""
    with socket.create_connection(("127.0.0.1", port), 2) as connection:
        connection.settimeout(1)
        connection.sendall(b"GET /health HTTP/1.0\r\n\r\n")
        try:
            return connection.recv(100)
        except OSError:
            return b""


def check_closed(processes: set[int], before: set[int]) -> None:
    """See that nobody else can send anything to a tree of processes."""
    ports, names = listening(processes)
    found = {port: (answers(port), attacked(port)) for port in ports - before}
    assert not found
    for name in names:
        assert not name.startswith("@"), "an abstract name has no permissions"
        folder = Path(name).parent
        if folder.exists():
            assert folder.stat().st_mode & 0o77 == 0
            assert folder.stat().st_uid == os.getuid()
            if os.getuid() == 0:  # as somebody else
                tried = subprocess.run([sys.executable, "-c", CONNECT, name], capture_output=True, text=True)
                assert tried.returncode
                assert (
                    "PermissionError" in tried.stderr or "FileNotFoundError" in tried.stderr
                )  # it has ended meanwhile
    if shutil.which("ss"):
        assert ports_by_ss(processes) <= before


def ports_by_ss(processes: set[int]) -> set[int]:
    """Return the TCP ports at which processes listen, as the system's own tool tells."""
    told = subprocess.run(["ss", "-ltnpH"], capture_output=True, text=True, check=True).stdout
    mine = [line for line in told.splitlines() if any(f"pid={process}," in line for process in processes)]
    return {int(line.split()[3].rpartition(":")[2]) for line in mine}


LISTEN = """
import socket, sys
with socket.create_server(("127.0.0.1", 0)) as server:
    print(server.getsockname()[1], flush=True)
    sys.stdin.read()
"""


def test_a_socket_that_listens_is_seen() -> None:
    """Both ways to look are used: a test of something that is not there must be able to fail."""
    with subprocess.Popen(
        [sys.executable, "-c", LISTEN], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    ) as process:
        port = int(process.stdout.readline())
        assert listening({process.pid})[0] == {port}
        if shutil.which("ss") is None:
            process.stdin.close()
            pytest.skip("ss is not installed: sockets that listen are looked for in /proc alone")
        assert ports_by_ss({process.pid}) == {port}
        with pytest.raises(AssertionError):
            check_closed({process.pid}, set())
        process.stdin.close()


def test_nothing_listens_while_processes_work(tmp_path: Path) -> None:
    installed("distributed")  # which attacks
    before, _ = listening({os.getpid()})
    note = tmp_path / "died"
    rows = Workers(2).rows(Dispatch([0, 1, 2, 3, -1]), MadeTasks(str(note), 0.05, kills=(2,)), ["0:0", "0:1"])
    done = dict([next(rows)])
    others = tree(os.getpid()) - {os.getpid()}
    assert len(others) >= 3
    check_closed(others | {os.getpid()}, before)
    done |= rows
    assert note.exists()
    assert {n for n, row in done.items() if row["status"] == "finished"} == {0, 1, 2, 3}
    assert "Unreadable" in done[-1]["error"] or "a" in done[-1]["error"]
    assert {row["device"] for n, row in done.items() if n >= 0} == {"0:0", "0:1"}
    assert not {row["process"] for n, row in done.items() if n >= 0} & tree(os.getpid())


def test_a_task_that_is_left_cleans_up(tmp_path: Path) -> None:
    before, note = tree(os.getpid()), tmp_path / "cleaned"
    with local_team(1, MadeTasks(str(note), 60.0), []) as team:
        while not team.workers():
            team.done(0.1)
        team.begin(0, *team.workers())
        while not note.with_suffix(".begun").exists():
            time.sleep(0.01)
    assert note.exists()
    assert not _workers(tree(os.getpid()) - before)


def _workers(processes: set[int]) -> list[int]:
    """Return those that are neither the process that others are forked from nor what watches over files."""
    server = [p for p in processes if b"forkserver" in Path(f"/proc/{p}/cmdline").read_bytes()]
    return [p for p in server if _parent(p) in server]


def _parent(process: int) -> int:
    return int(Path(f"/proc/{process}/stat").read_text("utf-8").rpartition(")")[2].split()[1])


@pytest.mark.exhaustive
@pytest.mark.slow
@pytest.mark.parametrize("what", ["study", "run"])
def test_nothing_listens_while_commands_work(tmp_path: Path, what: str, device: None) -> None:
    installed("distributed")
    installed("zarr")
    write_scene(tmp_path)
    (tmp_path / "long.toml").write_text(SCENE % (1.9, 2), "utf-8")
    arguments = {
        "study": [*write(tmp_path, [0], [1.5 + 0.001 * i for i in range(8)]), "--workers", "2"],
        "run": [*command(tmp_path / "long.toml", tmp_path / "out", "zarr"), "--workers", "2"],
    }[what]
    line = [sys.executable, "-m", "clsim", *arguments]
    most = 0
    with subprocess.Popen(line, env=ENVIRONMENT, stdout=subprocess.DEVNULL) as process:
        while process.poll() is None:  # from the start to the end
            found = tree(process.pid)
            check_closed(found, set())
            most = max(most, len(found))
            time.sleep(0.2)
    assert process.returncode == 0
    assert most >= 4, "the command, two workers, and what they are forked from"
    assert what == "run" or len(runs(tmp_path)) == 8


@pytest.fixture
def certificates(tmp_path: Path) -> dict[str, str]:
    """Make a key and a certificate that signs itself, and return the environment in which Dask uses both."""
    if shutil.which("openssl") is None:
        pytest.skip("openssl makes the certificates")
    key, certificate = tmp_path / "key.pem", tmp_path / "certificate.pem"
    line = [
        "openssl", "req", "-x509", "-newkey", "ec", "-pkeyopt", "ec_paramgen_curve:prime256v1", "-nodes", "-days", "1",
    ]  # fmt: skip
    subprocess.run([*line, "-subj", "/CN=clsim", "-keyout", key, "-out", certificate], check=True, capture_output=True)
    place = "DASK_DISTRIBUTED__COMM__TLS__"
    files = {
        f"{place}{who}__{what}": str(path)
        for who in ("SCHEDULER", "WORKER", "CLIENT")
        for what, path in (("KEY", key), ("CERT", certificate))
    }
    return files | {f"{place}CA_FILE": str(certificate), "DASK_DISTRIBUTED__COMM__REQUIRE_ENCRYPTION": "True"}


@pytest.mark.exhaustive
@pytest.mark.slow
def test_a_scheduler_with_certificates_serves_who_has_them(tmp_path, certificates: dict[str, str], device) -> None:
    installed("distributed")
    installed("zarr")
    scene = tmp_path / "scene.toml"
    scene.write_text(SCENE % (0.3, 2), "utf-8")
    assert main(command(scene, tmp_path / "one", "zarr")) == 0
    with made_cluster(tmp_path, 0) as (address, _):
        assert attacked(int(address.rpartition(":")[2])).startswith("runs programs as user"), "without certificates"
    (tmp_path / "scheduler.json").unlink()
    with made_cluster(tmp_path, 1, ["--protocol", "tls"], certificates) as (address, _):
        assert address.startswith("tls://")
        line = [sys.executable, "-m", "clsim", *command(scene, tmp_path / "many", "zarr"), "--scheduler", address]
        done = subprocess.run(line, env=ENVIRONMENT | certificates, capture_output=True, text=True)
        assert done.returncode == 0, done.stderr
        assert "encryption" not in done.stderr
        ports, _ = listening(tree(os.getpid()))
        assert int(address.rpartition(":")[2]) in ports
        assert attacked(int(address.rpartition(":")[2])) == ""
        without = subprocess.run(line, env=ENVIRONMENT, capture_output=True, text=True)
        assert without.returncode == 2
        assert "cannot be reached" in without.stderr
    assert content(tmp_path / "many") == content(tmp_path / "one")


def test_a_scheduler_elsewhere_without_certificates_is_warned_of(monkeypatch: pytest.MonkeyPatch) -> None:
    installed("distributed")
    monkeypatch.setattr("clsim.workflow.workers.check_reach", lambda scheduler: None)
    with pytest.warns(ClsimWarning, match=r"tcp://10\.0\.0\.1:8786 is reached without encryption.*use tls://"):
        Workers(scheduler="tcp://10.0.0.1:8786").check("--scheduler", "a run on workers")
    for quiet in ("tls://10.0.0.1:8786", "tcp://127.0.0.1:8786"):
        Workers(scheduler=quiet).check("--scheduler", "a run on workers")
