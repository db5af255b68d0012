"""What stands between pressure and voltage."""
