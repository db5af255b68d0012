"""What PoCL made of the inner loops of render.cl, of a tone and of pulses: prints them, and fails if one holds a call."""

import os
import re
import subprocess
import sys
import tempfile
from pathlib import Path

BUILD = """
import clsim
tone = clsim.Signal.tone(40e3, 0.1, 192e3, fade=0.005)
pulses = clsim.Signal.pulses(clsim.Signal.tone(40e3, 0.001, 192e3), 0.05, 2)
room = clsim.Shoebox((8, 6, 3), clsim.Material.from_reflection(0.9))
for signal in (tone, pulses):
    source = clsim.Source("s", signal, clsim.Trajectory.line((4, 3, 1), (4.1, 3, 1), 0.1))
    scene = clsim.Scene(room, clsim.Air(), [source], [clsim.Receiver("r", clsim.Trajectory.fixed((1, 1, 2)))])
    clsim.render(clsim.find_paths(scene, 1), 192e3, duration=0.1, response_error_db="centre")
"""


def inner_loop(listing: str) -> list[str]:
    """Return the shortest backward jump's body that holds the most fused multiply-adds."""
    lines = [(int(m[1], 16), m[2]) for m in re.finditer(r"^\s*([0-9a-f]+):\s+(.*)$", listing, re.MULTILINE)]
    place = {address: i for i, (address, _) in enumerate(lines)}
    best: list[str] = []
    score = 0.0
    for i, (address, text) in enumerate(lines):
        jump = re.match(r"j\w+\s+([0-9a-f]+)", text)
        if jump and int(jump[1], 16) < address and int(jump[1], 16) in place:
            body = [t for _, t in lines[place[int(jump[1], 16)] : i + 1]]
            fused = sum("vfmadd" in t and "(" in t for t in body)
            if fused >= 8 and fused / len(body) > score:
                best, score = body, fused / len(body)
    return best


def main() -> None:
    """Build, disassemble, print, judge."""
    with tempfile.TemporaryDirectory() as cache:
        environment = os.environ | {"POCL_CACHE_DIR": cache, "PYOPENCL_NO_CACHE": "1"}
        subprocess.run([sys.executable, "-c", BUILD], env=environment, check=True)
        objects = list(Path(cache).rglob("render.so"))
        if not objects:
            sys.exit("no render.so in the cache: the default device is not PoCL on a CPU")
        dump = ["objdump", "-d", "--no-show-raw-insn"]
        listings = [subprocess.run([*dump, str(o)], capture_output=True, text=True, check=True).stdout for o in objects]
    failed = False
    for listing in listings:
        body = inner_loop(listing)
        print("\n".join(body))
        fused = sum("vfmadd" in line for line in body)
        calls = sum(line.startswith("call") for line in body)
        print(f"{len(body)} instructions, {fused} fused multiply-adds, {calls} calls\n")
        failed |= bool(calls) or not body
    sys.exit(failed)


if __name__ == "__main__":
    main()
