"""Names of all files of a run, known before anything is computed."""

from __future__ import annotations

from dataclasses import dataclass

from clsim.files.names import file_names
from clsim.output.stores import store_kinds
from clsim.scene_file.scene import SceneFile

COMPLETED = "scene.completed.toml"
GROUND_TRUTH = "ground_truth.npz"
MOST_DRAWN = 16  # receivers
PICTURES = ("paths", "spectrogram", "echogram")  # of each, the first only where paths come and go


@dataclass(frozen=True, slots=True)
class RunOutputs:
    """Files that a run may write into its folder."""

    receivers: list[str]  # names of the receivers, as files are called
    sounds: list[str]  # names of receivers and arrays, as files of sound are called
    sound: list[str]  # files or folders of the sound
    table: str  # the path table; empty if none is wanted
    drawn: list[str]  # receivers whose pictures are drawn, by their names

    @classmethod
    def of(cls, file: SceneFile, store: str, table: str, *, pictures: bool) -> RunOutputs:
        """Return the outputs of a scene file for a kind of store and of table ("none" for no table)."""
        names = file_names(tuple(receiver.name for receiver in file.scene.receivers))
        sounds = file_names(tuple(dict.fromkeys(row for end in file.scene.receivers for row, _ in end.rows)))
        file_of_table = "" if table == "none" else f"paths.{table}"
        sound, drawn = store_kinds()[store].names(sounds), names[:MOST_DRAWN] if pictures else []
        return cls(names, sounds, sound, file_of_table, drawn)

    def beside_sound(self, changing: bool = True) -> list[str]:
        """Return the files made after the sound, the completed scene last; `changing`: paths come and go."""
        tables = [self.table, GROUND_TRUTH] if self.table else [GROUND_TRUTH]
        kinds = PICTURES if changing else PICTURES[1:]
        return [*tables, *(picture(name, kind) for name in self.drawn for kind in kinds), COMPLETED]

    def all(self) -> list[str]:
        """Return all files that may be written."""
        return [*self.sound, *self.beside_sound()]


def picture(receiver: str, kind: str) -> str:
    """Return the name of a picture of a receiver."""
    return f"{receiver}_{kind}.png"
