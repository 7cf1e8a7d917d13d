"""An uncertainty budget of the joint fit (JCGM 100; ITTC 7.5-02-06-04/05): what each input does to each derivative.

At its optimum the fit is linear in its inputs: a prior's mean wrong by dx moves the derivatives by c dx, and noise by a gain of its
own. Contributions c u, input by input, sum to the fit's covariance; that is checked, not assumed.
"""

from .combine import Budget, Judged, budget_of, judged
from .components import Component, ModeOrigin
from .given import Shape, absent
from .repeats import Repeats, repeats_of

__all__ = [
    "Budget",
    "Component",
    "Judged",
    "ModeOrigin",
    "Repeats",
    "Shape",
    "absent",
    "budget_of",
    "judged",
    "repeats_of",
]
