"""Hypotheses against data, of any simulator: fits with the noise estimated beside them, evidence, the search through effects."""
