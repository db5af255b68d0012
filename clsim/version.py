"""The version, in one place: the package's metadata are made from here."""

__version__ = "0.3.0"
