"""A plan as plain text lines for a terminal."""

from __future__ import annotations

from ...record.plan_file import Campaign, PlanFile, ReleaseRow, RuleTable

SHORT = {
    "y_v": "Y_v",
    "y_r_minus_mu": "Y_R",
    "n_v": "N_v",
    "n_r": "N_r",
    "m_minus_y_vdot": "m'",
    "i_minus_n_rdot": "I'",
}
_COLUMNS = {
    "omega_rad_s": "w rad/s",
    "damping_per_s": "decay 1/s",
    "d_omega_d_line_length_rad_s_m": "dw/dL",
    "d_omega_d_tow_point_rad_s_m": "dw/dX_T",
    "d_omega_d_speed_rad_m": "dw/dU",
    "dropped_s": "dropped s",
    "seconds": "s",
}


def plan_lines(plan: PlanFile) -> list[str]:
    """Interval against number of runs, the chosen campaign with its warnings, the rules."""
    lines = [f"{plan.candidates} tows may be chosen" + _excluded(plan)]
    for kind, example in plan.excluded_example.items():
        lines.append(f"  left out ({kind}), for one: {example}")
    wish = "".join(f"{plan.wished_percent[n]:8.2f}" for n in SHORT)
    for title, campaigns in (("A", plan.a_optimal), ("D", plan.d_optimal)):
        lines += ["", f"{title}-optimal campaigns: half-width of the 95 % interval, %"]
        lines.append(f"{'runs':>6}" + "".join(f"{symbol:>8}" for symbol in SHORT.values()))
        lines.append(f"{'wish':>6}{wish}")
        for count, campaign in enumerate(campaigns, 1):
            lines.append(
                f"{count:6d}"
                + "".join(f"{campaign.percent[n]:8.2f}" for n in SHORT)
                + ("  reached" if campaign.reached else "")
            )
    needed = ", ".join(f"{s} {plan.runs_needed[n] or 'not reached'}" for n, s in SHORT.items())
    lines += [
        "",
        f"runs needed: {needed}",
        "",
        f"the campaign of {len(plan.chosen.runs)}:",
        *campaign_lines(plan.chosen),
    ]
    if plan.own is not None:
        lines += ["", f"your campaign of {len(plan.own.runs)}:", *campaign_lines(plan.own)]
        lines.append(
            "half-width of its 95 % intervals, %: "
            + ", ".join(f"{s} {plan.own.percent[n]:.2f}" for n, s in SHORT.items())
        )
    if plan.releases:
        lines += ["", *release_lines(plan.releases)]
    if plan.release_rule is not None:
        lines.append(plan.release_rule)
    for rule in plan.rules:
        lines += ["", *rule_lines(rule)]
    return [*lines, "", *(f"note: {note}" for note in plan.notes)]


def campaign_lines(campaign: Campaign) -> list[str]:
    """The tows of a campaign, one a line, each with its warnings below it."""
    lines = [
        f"{'':>3}{'X_T m':>7}{'L m':>6}{'U m/s':>7}{'T N':>7}{'y m':>6}{'beta':>7}{'s':>7}{'w':>7}{'cycles':>7}"
        f"{'angle':>7}{'wall m':>7}{'line %':>7}"
    ]
    for number, run in enumerate(campaign.runs, 1):
        omega = "-" if run.omega_rad_s is None else f"{run.omega_rad_s:.3f}"
        lines.append(
            f"{number:3d}{run.tow_point_m:7.3f}{run.line_length_m:6.2f}{run.speed_m_s:7.3f}{run.tension_n:7.2f}{run.release_y_m:6.2f}"
            f"{run.release_beta_rad:+7.3f}{run.duration_s:7.1f}{omega:>7}{run.cycles:7.2f}{run.largest_angle_rad:7.3f}"
            f"{run.wall_room_m:7.2f}{100 * run.line_share:7.0f}"
        )
        lines += [f"    warning: {warning}" for warning in run.warnings]
    return lines


def release_lines(rows: list[ReleaseRow]) -> list[str]:
    """Release against what the scale and the six gain; a star: [limits] forbid it in some run."""
    lines = [
        "release (angle of the line, heading 0) against what it tells, sd in %: the scale (T) without and with a gauge, and",
        "the six with it; *: [limits] forbid it in some run",
        f"{'degrees':>11}{'no gauge':>10}{'gauge':>8}"
        + "".join(f"{s:>8}" for s in SHORT.values())
        + f"{'least T %':>11}",
    ]
    for row in rows:
        angle = "as planned" if row.release_deg is None else f"{row.release_deg:g}"
        angle += "*" if row.limits else " "
        if row.scale_sd_percent is None or row.sd_percent is None:
            lines.append(f"{angle:>11}  a run goes broadside or slackens its line")
            continue
        lines.append(
            f"{angle:>11}{row.scale_sd_percent:>10.3g}{row.gauged_scale_sd_percent:>8.2f}"
            + "".join(f"{row.sd_percent[n]:>8.2f}" for n in SHORT)
            + f"{100 * (row.least_line_share or 0.0):>11.0f}"
        )
    return lines


def rule_lines(rule: RuleTable) -> list[str]:
    """A rule and its table."""
    if not rule.rows:
        return [rule.rule, "  (these tows do not swing)"]
    names = list(rule.rows[0])
    heads = [_COLUMNS.get(name, SHORT.get(name, name)) for name in names]
    lines = [rule.rule, "".join(f"{head:>10}" for head in heads)]
    return [*lines, *("".join(f"{row[name]:>10.3g}" for name in names) for row in rule.rows)]


def _excluded(plan: PlanFile) -> str:
    if not plan.excluded:
        return ""
    return "; left out: " + ", ".join(f"{count} for {kind}" for kind, count in plan.excluded.items())
