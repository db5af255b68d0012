"""Diffuse tails: energy by rays, and noise shaped by it."""
