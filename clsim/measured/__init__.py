"""Rooms that somebody measured, against simulations of them."""
