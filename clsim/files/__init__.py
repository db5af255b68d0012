"""Files as clsim reads and writes them: whole, or not at all."""
