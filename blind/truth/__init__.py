"""A reality of its own: physics, camera and noise that share neither code nor functional form with the rest of the product.

Nothing here imports geometry, simulate, identify or diagnose; symbols and signs are those of theory.md. A number of a lane is named
``effect.number`` (or plainly, for the hull and the tow) and is zero where reality does not have that effect.
"""

from .cases import Case, RunTruth, lane_of
from .motion import Path, swim

__all__ = ["Case", "Path", "RunTruth", "lane_of", "swim"]
