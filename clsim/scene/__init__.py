"""What the user describes: frozen values, checked when they are made."""
