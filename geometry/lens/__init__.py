"""Lens calibration from boards."""
