"""Studies: one scene file rendered many times with other values of some of its fields."""
