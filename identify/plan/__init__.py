"""Experiment design: which tows, and how many, bring each derivative to a wished interval."""

from .candidates import Candidates, farthest_release, gather, nearer
from .checks import Conduct, conduct, swing
from .choose import best_campaigns, exchange, greedy, score
from .information import prior_information, relative_covariance, run_information, unit_tow
from .kept import KeptTow, kept_tows, tows
from .plan import guessed_hull, judged, make_plan, setting_of, thesis_rules
from .releases import release_rows, release_rule, released_at, scale_sd
from .rules import campaign_sd, cycles_rule, swing_sensitivity, transient_rule
from .setting import Setting, TowPlan

__all__ = [
    "Candidates",
    "Conduct",
    "KeptTow",
    "Setting",
    "TowPlan",
    "best_campaigns",
    "campaign_sd",
    "conduct",
    "cycles_rule",
    "exchange",
    "farthest_release",
    "gather",
    "greedy",
    "guessed_hull",
    "judged",
    "kept_tows",
    "make_plan",
    "nearer",
    "prior_information",
    "relative_covariance",
    "release_rows",
    "release_rule",
    "released_at",
    "run_information",
    "scale_sd",
    "score",
    "setting_of",
    "swing",
    "swing_sensitivity",
    "thesis_rules",
    "tows",
    "transient_rule",
    "unit_tow",
]
