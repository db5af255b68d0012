"""Intervals in which paths are there: clearance, occlusion, subdivision of time."""
