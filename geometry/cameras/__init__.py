"""Two cameras over one tow: their clocks told from the motion, their views joined, and whether they agree."""
