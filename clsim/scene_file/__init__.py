"""Scene files: TOML with the words of the constructors, checked field by field."""

from clsim.scene_file.scene import (
    SceneFile,
    SceneModel,
    build_scene,
    completed_scene,
    load_scene,
    referenced_files,
    scene_schema,
)

__all__ = [
    "SceneFile",
    "SceneModel",
    "build_scene",
    "completed_scene",
    "load_scene",
    "referenced_files",
    "scene_schema",
]
