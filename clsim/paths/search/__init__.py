"""Searches for paths, by kind of room and of vertex."""
