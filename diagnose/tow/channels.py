"""What is measured of a run: the columns of its values."""

CHANNELS = ("y", "beta", "line", "distance", "pull")
LINE, DISTANCE, PULL = (CHANNELS.index(name) for name in ("line", "distance", "pull"))
"""The last one only where some run of the campaign has it."""

__all__ = ["CHANNELS", "DISTANCE", "LINE", "PULL"]
