"""What walls are made of."""
