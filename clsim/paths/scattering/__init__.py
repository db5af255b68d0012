"""Paths by things that scatter and move, among any reflections: their law, their search, and the truth about them."""
