"""Vertices of paths: edges, pairs of edges, scatterers."""
