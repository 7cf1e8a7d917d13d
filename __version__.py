"""The version: everybody's, so it stands by itself and imports nothing."""

__version__ = "0.3.0"
