"""towline: from a camera recording of a towed ship model to its hydrodynamic derivatives."""

__version__ = "0.1.0"
