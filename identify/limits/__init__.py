"""What the records can tell and what they cannot: bounds, combinations, profiles, the run that would help."""
