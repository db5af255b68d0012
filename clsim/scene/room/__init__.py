"""Rooms: what encloses the sound."""
