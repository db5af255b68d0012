"""Rendering methods: what each can render, at what cost, and the contribution that does it."""
