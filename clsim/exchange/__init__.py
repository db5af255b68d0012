"""Recordings as other programs take them."""
