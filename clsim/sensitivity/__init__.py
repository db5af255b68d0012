"""Derivatives of received signals: tangents of paths, the linear map from them to signals, and its transpose."""
