"""Numerical methods, arrays in and arrays out; no acoustics."""
