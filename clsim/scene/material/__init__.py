"""Materials of walls."""
