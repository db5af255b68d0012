"""Viewer pages and sounds of the site, rendered as it is built.

A page of docs/ names one in a comment of its own line, such as ``<!-- viewer: door -->`` or ``<!-- sound: circle -->``.
"""

import re
import sys
import warnings
from collections.abc import Callable
from pathlib import Path

import soundfile

import clsim

EXAMPLES = Path(clsim.__file__).parents[1] / "examples"  # the gate builds the site of a copy of the pages
COMMENT = re.compile(r"^<!-- (viewer|sound): (\w+) -->$", re.MULTILINE)
FRAME = '<iframe src="media/{}.html" title="interactive view" loading="lazy" style="width:100%;height:32rem;border:0"></iframe>'
PLAYER = '<audio controls preload="none" src="media/{}.flac"></audio>'
RATE = 24e3  # Hz


def embedded(text: str) -> str:
    """Replace the comments of a page by frames and players."""

    def block(found: re.Match[str]) -> str:
        return f"```{{raw}} html\n{(FRAME if found[1] == 'viewer' else PLAYER).format(found[2])}\n```"

    return COMMENT.sub(block, text)


def write_media(folder: Path) -> None:
    """Write all viewers and sounds."""
    from clsim.paths.path_table import view_scene

    warnings.simplefilter("ignore", clsim.ClsimWarning)  # of edges that are left out
    folder.mkdir(parents=True, exist_ok=True)
    sys.path.append(str(EXAMPLES))
    for name, make in VIEWERS.items():
        paths, duration = make()
        view_scene(paths, folder / f"{name}.html", title=name, duration=duration, frames=60)
    import turning_listener as listener

    for name, render in SOUNDS.items():
        soundfile.write(folder / f"{name}.flac", listener.scaled(render()), int(RATE), subtype="PCM_16")
    ears = listener.scaled(listener.rendered(listener.LAP))
    listener.write_page(ears, listener.talker_path(listener.LAP), folder / "listener.html")


def _circle() -> tuple[clsim.PathSet, float]:
    return clsim.find_paths(clsim.load_scene(EXAMPLES / "circle.toml").scene, 2), 1.0


def _door() -> tuple[clsim.PathSet, float]:
    from swinging_door import door_scene

    return clsim.find_paths(door_scene(4.0), 1), 4.0


def _person() -> tuple[clsim.PathSet, float]:
    from walking_person import CARRIER, DURATION, RATE, scene_of

    return clsim.find_paths(scene_of(clsim.Signal.tone(CARRIER, DURATION, RATE)), 0, scattering_order=0), DURATION


def _rendered(source: clsim.Source, reflection: float, tail: str, duration: float) -> clsim.Recording:
    """Render one source and one receiver in a room of 8 x 6 x 3 m."""
    ear = clsim.Receiver("ear", clsim.Trajectory.fixed((6.5, 3.0, 1.5)))
    room = clsim.Shoebox((8.0, 6.0, 3.0), clsim.Material.from_reflection(reflection))
    paths = clsim.find_paths(clsim.Scene(room, clsim.Air(), [source], [ear]), max_order=6 if reflection else 0)
    return clsim.render(paths, RATE, duration=duration, tail=tail)


def _circling_tone() -> clsim.Recording:
    tone = clsim.Signal.tone(1e3, 4.0, RATE, fade=0.05)
    circle = clsim.Trajectory.circle((4.0, 3.0, 1.5), 2.0, 1.0, 4.0)  # 12.6 m/s
    return _rendered(clsim.Source("siren", tone, circle), 0.0, "off", 4.0)


def _chirp(reflection: float) -> Callable[[], clsim.Recording]:
    def render() -> clsim.Recording:
        chirp = clsim.Signal.chirp(400.0, 8e3, 0.25, RATE, window="tukey")
        source = clsim.Source("loudspeaker", chirp, clsim.Trajectory.fixed((2.0, 2.0, 1.5)))
        return _rendered(source, reflection, "auto" if reflection else "off", 1.5)

    return render


VIEWERS = {"circle": _circle, "door": _door, "person": _person}
SOUNDS = {"circling_tone": _circling_tone, "chirp_free_field": _chirp(0.0), "chirp_in_room": _chirp(0.9)}
