"""A missing law, written down: terms that a hydrodynamicist would write, searched by whole-path fits and handed on as an effect."""
