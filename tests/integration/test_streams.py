"""Standard streams that are closed, full or know few letters: every command works, and ends with its status."""

import os
import subprocess
import sys
from pathlib import Path

import pytest
from exhaustive import exhaustive
from made_studies import ENVIRONMENT, SCENE

from clsim.cli import main


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("streams")
    (folder / "scene.toml").write_text(SCENE.replace("[render]", '[render]\nengine = "reference"'), "utf-8")
    return folder


def ran(folder: Path, redirected: str, *arguments: str, **more: str) -> subprocess.CompletedProcess[bytes]:
    """Run a command of clsim in a shell that redirects its streams."""
    line = ["/bin/sh", "-c", f'exec "$@" {redirected}', "sh", sys.executable, "-m", "clsim", *arguments]
    return subprocess.run(line, cwd=folder, env=ENVIRONMENT | {"MPLBACKEND": "agg"} | more, capture_output=True)


pytestmark = pytest.mark.skipif(os.name == "nt", reason="a shell of POSIX redirects the streams")
COMMANDS = [
    ["materials"],
    exhaustive(["run", "scene.toml", "-o", "out", "--no-plots", "--force"]),
    exhaustive(["check", "scene.toml"]),
    exhaustive(["paths", "scene.toml"]),
    exhaustive(["devices"]),
    exhaustive(["schema"]),
    exhaustive(["rir", "scene.toml", "-o", "out.npz", "--force"]),
    exhaustive(["view", "scene.toml", "-o", "out.html", "--force"]),
]


@pytest.mark.parametrize("arguments", COMMANDS)
def test_a_closed_stream_changes_no_status(folder: Path, arguments: list[str]) -> None:
    whole = ran(folder, "", *arguments)
    assert whole.returncode == 0
    more = ("2>&-", ">&-", "<&-", "2>/dev/full") if len(arguments) > 1 else ()
    for redirected in ("<&- >&- 2>&-", *more):
        done = ran(folder, redirected, *arguments)
        assert done.returncode == 0, redirected
        assert done.stdout == (b"" if ">&- " in f"{redirected} ".replace("2>&-", "") else whole.stdout)
        assert b"Traceback" not in done.stderr


@pytest.mark.parametrize(
    "redirected", [exhaustive("2>&-"), exhaustive(">&-"), "<&- >&- 2>&-", exhaustive("2>/dev/full")]
)
def test_an_error_keeps_its_status(folder: Path, redirected: str) -> None:
    done = ran(folder, redirected, "check", "none.toml")
    assert done.returncode == 2
    assert done.stdout == b""
    assert done.stderr == (
        b"" if "2" in redirected else b"clsim: error: none.toml: cannot be read: No such file or directory\n"
    )


def test_what_cannot_be_printed_is_an_error(folder: Path) -> None:
    for argument in ("materials", "--version"):
        done = ran(folder, ">/dev/full", argument)
        assert done.returncode == 2
        assert done.stderr.decode() == "clsim: error: [Errno 28] No space left on device\n"


def test_names_give_a_terminal_no_commands(folder: Path) -> None:
    """The escape that begins commands, and a byte that does so on terminals of eight bits, are printed as escapes."""
    pty = pytest.importorskip("pty")
    ours, theirs = pty.openpty()
    line = [sys.executable, "-m", "clsim", "new", os.fsencode(folder) + b"/q\x1b[31m\x9b.toml"]
    try:
        done = subprocess.run(line, env=ENVIRONMENT, stdout=theirs, stderr=subprocess.PIPE)
        assert (done.returncode, done.stderr) == (0, b"")
        assert os.read(ours, 1000).rstrip() == os.fsencode(folder) + rb"/q\x1b[31m\udc9b.toml"
    finally:
        os.close(ours)
        os.close(theirs)


def test_a_stream_of_few_letters_gets_escapes(folder: Path, capsys) -> None:
    done = ran(folder, "", "materials", PYTHONIOENCODING="ascii", PYTHONUTF8="0")
    assert done.returncode == 0
    assert done.stderr == b""
    assert main(["materials"]) == 0
    whole = capsys.readouterr().out
    assert done.stdout.decode("ascii") == whole.encode("ascii", "backslashreplace").decode()
    assert not whole.isascii()
