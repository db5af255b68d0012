"""Paths that turn round an edge, among any reflections: their law, their search, and when they are there."""
