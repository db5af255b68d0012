"""Legs of paths: by surfaces at rest, and by surfaces of which some move."""
