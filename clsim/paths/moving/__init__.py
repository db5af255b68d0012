"""Paths by bodies that move: image events, their search, and what bodies hide."""
