"""Towed models for the diagnosis: their data, numbers and rates, what a camera sees of them, what only tows have."""
