"""Files and pictures: each written whole or not at all."""
