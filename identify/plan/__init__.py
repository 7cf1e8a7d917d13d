"""Experiment design: which tows, and how many, bring each derivative to a wished interval."""

from .candidates import Candidates, farthest_release, gather
from .checks import Conduct, conduct, swing
from .choose import best_campaigns, exchange, greedy, score
from .information import prior_information, relative_covariance, run_information, unit_tow
from .plan import guessed_hull, judged, make_plan, setting_of, thesis_rules
from .rules import campaign_sd, cycles_rule, swing_sensitivity, transient_rule
from .setting import Setting, TowPlan

__all__ = [
    "Candidates",
    "Conduct",
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
    "make_plan",
    "prior_information",
    "relative_covariance",
    "run_information",
    "score",
    "setting_of",
    "swing",
    "swing_sensitivity",
    "thesis_rules",
    "transient_rule",
    "unit_tow",
]
