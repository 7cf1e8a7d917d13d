"""The thesis's other estimators, one a module."""
