"""Lights and discs: found, followed and fitted."""

from .follow import SpotFollower

__all__ = ["SpotFollower"]
