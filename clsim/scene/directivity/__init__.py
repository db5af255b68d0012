"""How loud ends are in each direction."""
