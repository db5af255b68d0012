"""Paths by mirror reflections from walls."""
