"""From a scene file to a recording in a folder, in one place for all commands."""
