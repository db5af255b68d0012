"""Whether a checkout of clsim gives what another one gave, to the last bit: SHA-256 of samples, path tables and files.

Write hashes from the state before (``frozen.py OLD --write frozen.json``: arrays go into the folder frozen/ beside), then
compare (``frozen.py NEW --against frozen.json``): a line for each scene, and exit status 1 if one has changed.
"""

import argparse
import difflib
import hashlib
import json
import os
import platform
import re
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

import numpy as np

HERE = Path(__file__).resolve().parent
FROZEN = HERE / "frozen_hashes.json"


def canonical(array: np.ndarray) -> np.ndarray:
    """Return an array whose bytes say nothing but its values: whole numbers of one type, NaN of one kind."""
    if array.dtype.kind in "iu":
        return array.astype(np.int64)
    if array.dtype.kind in "fc" and np.isnan(array).any():
        array = array.copy()
        array[np.isnan(array)] = np.nan
    return np.ascontiguousarray(array)


def digest(array: np.ndarray) -> str:
    """Return the hash of type, shape and bytes."""
    return hashlib.sha256(f"{array.dtype.str} {array.shape} ".encode() + array.tobytes()).hexdigest()


def difference(name: str, old: np.ndarray, new: np.ndarray) -> str:
    """Return the difference of two arrays in words."""
    if old.dtype.kind == "U" and old.shape == new.shape == ():
        lines = (str(text).splitlines() for text in (old, new))
        return "\n".join(difflib.unified_diff(*lines, name, name, n=0, lineterm=""))
    if old.shape != new.shape or old.dtype != new.dtype:
        return f"{name}: {old.dtype} {old.shape} became {new.dtype} {new.shape}"
    changed = np.count_nonzero((old != new) & ~((old != old) & (new != new)))
    if old.dtype.kind not in "fc":
        return f"{name}: {changed} of {old.size} values"
    lost = int(np.count_nonzero(np.isfinite(old) != np.isfinite(new)))
    both = np.isfinite(old) & np.isfinite(new)
    wide = np.complex128 if old.dtype.kind == "c" else np.float64
    apart, size = (np.linalg.norm(x[both].astype(wide)) for x in (new.astype(wide) - old.astype(wide), old))
    db = 20.0 * np.log10(apart / size) if apart > 0.0 and size > 0.0 else -np.inf
    return f"{name}: {db:.1f} dB, {changed} of {old.size} values" + (f", {lost} finite in one only" if lost else "")


def computed(checkout: Path, folder: Path, names: list[str]) -> Iterator[tuple[str, dict[str, np.ndarray] | str, str]]:
    """Yield name, arrays (or why there are none) and seconds of each scene, computed in another process."""
    environment = {**os.environ, "PYTHONPATH": str(checkout)}
    line = [sys.executable, str(HERE / "frozen_scenes.py"), str(checkout), str(folder), *names]
    with subprocess.Popen(line, env=environment, stdout=subprocess.PIPE, text=True, cwd=folder) as process:
        for told in process.stdout:
            name, seconds = told.split()
            if (folder / f"{name}.txt").exists():
                yield name, (folder / f"{name}.txt").read_text("utf-8"), seconds
                continue
            with np.load(folder / f"{name}.npz") as content:
                yield name, {n: canonical(content[n]) for n in content.files}, seconds
    if process.returncode:
        raise SystemExit(f"the scenes ended with status {process.returncode}")


def verdict(name: str, arrays: dict[str, np.ndarray], hashes: dict[str, str] | None, kept: Path) -> list[str]:
    """Return the changes of a scene, one text each; none if nothing changed."""
    if hashes is None:
        return ["is not in the reference"]
    changed = [n for n in hashes if n in arrays and digest(arrays[n]) != hashes[n]]
    told = [f"{n}: is no more" for n in hashes if n not in arrays]
    if not changed or not kept.exists():
        return told + [f"{n}: changed" for n in changed]
    with np.load(kept) as content:
        return told + [difference(n, content[n], arrays[n]) for n in changed]


def group(name: str) -> str:
    """Return the kind of an array of a scene: samples, paths or files."""
    if "paths." in name or "table." in name or "truth." in name:
        return "paths"
    return "samples" if "samples" in name or name.endswith(".wav") else "files"


def grouped(arrays: dict[str, np.ndarray]) -> dict[str, str]:
    """Return one hash for the samples of a scene, one for its path tables, and one for the rest."""
    hashes: dict[str, hashlib._Hash] = {}
    for name in sorted(arrays):
        hashes.setdefault(group(name), hashlib.sha256()).update(f"{name} {digest(arrays[name])} ".encode())
    return {kind: h.hexdigest() for kind, h in hashes.items()}


def machine() -> dict[str, str]:
    """Return the names of processor and numerical libraries, which decide the rounding of results."""
    from importlib.metadata import PackageNotFoundError, version

    try:
        text = Path("/proc/cpuinfo").read_text("utf-8")
        family = dict(re.findall(r"^(cpu family|model|vendor_id)\t*: (.*)$", text, re.MULTILINE))
    except OSError:
        family = {"model": platform.processor()}
    known = {"processor": " ".join(family[key] for key in sorted(family))}
    for package in ("numpy", "scipy", "pocl-binary-distribution"):
        try:
            known[package] = version(package)
        except PackageNotFoundError:
            known[package] = "none"
    return known


def freeze(checkout: Path, names: list[str]) -> None:
    """Write `FROZEN`, the hashes that tests compare, of these scenes or all."""
    frozen = json.loads(FROZEN.read_text("utf-8")) if FROZEN.exists() and names else {}
    frozen = {"made_with": machine(), "scenes": frozen.get("scenes", {})}
    with tempfile.TemporaryDirectory() as name:
        for scene, arrays, seconds in computed(checkout, Path(name), names):
            if isinstance(arrays, str):
                raise SystemExit(arrays)
            frozen["scenes"][scene] = grouped(arrays) | {"seconds": round(float(seconds), 1)}
            print(f"frozen   {scene}", flush=True)
    FROZEN.write_text(json.dumps(frozen, indent=1, sort_keys=True) + "\n", "utf-8")


def main() -> int:
    """Compute, and write or compare; return the exit status."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("checkout", type=Path, help="folder that holds the package clsim")
    parser.add_argument("--write", type=Path, metavar="FILE", help="write hashes here, and arrays into a folder beside")
    default = HERE / "frozen.json"
    parser.add_argument(
        "--against", type=Path, metavar="FILE", default=default, help="default: frozen.json beside this"
    )
    parser.add_argument("--freeze", action="store_true", help=f"write the hashes that tests compare: {FROZEN.name}")
    parser.add_argument("--only", nargs="+", default=[], metavar="NAME", help="these scenes")
    options = parser.parse_args()
    if options.freeze:
        freeze(options.checkout.resolve(), options.only)
        return 0
    if not options.write and not options.against.exists():
        parser.error(f"{options.against} is missing: write it from the state before, with --write")
    file = (options.write or options.against).resolve()
    read = file.exists() and (options.only or not options.write)  # scenes that are not written anew stay
    reference = json.loads(file.read_text("utf-8")) if read else {}
    beside, bad = file.with_suffix(""), 0
    with tempfile.TemporaryDirectory() as name:
        for scene, arrays, seconds in computed(options.checkout.resolve(), Path(name), options.only):
            if isinstance(arrays, str):
                bad += 1
                print(f"FAILED   {scene}\n{arrays}", flush=True)
            elif options.write:
                reference[scene] = {n: digest(x) for n, x in arrays.items()}
                beside.mkdir(parents=True, exist_ok=True)
                np.savez_compressed(beside / f"{scene}.npz", **arrays)
                print(f"written  {scene} ({len(arrays)} arrays, {seconds} s)", flush=True)
            else:
                told = verdict(scene, arrays, reference.get(scene), beside / f"{scene}.npz")
                more = sorted(set(arrays) - set(reference.get(scene, arrays)))
                bad += bool(told)
                print(f"{'CHANGED ' if told else 'same    '} {scene} ({len(arrays)} arrays, {seconds} s)", flush=True)
                print("".join(f"  {text}\n" for text in [*told, *(f"{n}: is new" for n in more)]), end="", flush=True)
    if options.write:
        options.write.write_text(json.dumps(reference, indent=1, sort_keys=True) + "\n", "utf-8")
    return 1 if bad else 0


if __name__ == "__main__":
    sys.exit(main())
