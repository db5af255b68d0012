"""The process that workers are forked from: started first, with the modules of workers in it."""

import json
import subprocess
import sys

from clsim.study import OF_WORKERS
from clsim.study.member import MemberTasks
from clsim.workflow.processes import _start_method

ORDER = """
import argparse, json, sys
from clsim.commands import study
before = sorted({"numpy", "clsim.study.run"} & set(sys.modules))
told = []
study.start_server = lambda modules: told.append([list(modules), "clsim.study.run" in sys.modules])
names = "study", "output", "resume", "retry", "limit", "workers", "scheduler"
try:
    study.study(argparse.Namespace(**dict.fromkeys(names), **{}))
except Exception:
    pass
print(json.dumps([before, told]))
"""
LOADED = """
import multiprocessing, sys
from clsim.workflow.processes import start_server
def there():
    return sorted(set(%r) - set(sys.modules))
if __name__ == "__main__":
    start_server(%r)
    with multiprocessing.get_context("forkserver").Pool(1) as pool:
        print(pool.apply(there))
"""


def printed(script: str) -> str:
    return subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True).stdout


def test_the_command_starts_workers_before_it_loads_what_it_needs() -> None:
    before, told = json.loads(printed(ORDER))
    assert before == []
    assert told == [[list(OF_WORKERS), False]]


def test_workers_have_their_modules_from_the_beginning(tmp_path) -> None:
    if _start_method() != "forkserver":
        return
    script = tmp_path / "made.py"
    script.write_text(LOADED % (OF_WORKERS, OF_WORKERS), "utf-8")
    done = subprocess.run([sys.executable, script], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"
    assert MemberTasks.loads == OF_WORKERS
