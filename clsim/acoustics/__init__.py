"""Formulae: arrays in, arrays out; each cites its source or derives what it computes."""
