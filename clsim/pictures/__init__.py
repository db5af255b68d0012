"""Plots and HTML pages made from plain values."""
