"""Diffuse tails: energy by rays, and what sounds of it."""
