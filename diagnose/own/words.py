"""The answer about a model of one's own in plain words."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from ...record.gap_file import GapFile
from ..inference.evidence import CONVERGED_GAIN
from ..inference.held_out import Shrink
from ..inference.scan import Leftover
from ..words import DISAGREE, NOTABLE, STILL_MOVING, is_open

CHANGED = 0.01
"""A number that changes by less than this share with what is missing is not spoken of."""


def sentences(file: GapFile, held: Shrink | None, rest: Leftover, titles: Mapping[str, str]) -> list[str]:
    """The summary.

    Parameters
    ----------
    file : gap.json
    held : how far the gap shrinks, or None
    rest : what the best hypothesis leaves
    titles : of the effects, by name
    """
    said = _of_verdict(file, held, rest, titles)
    if file.next_experiment is not None:
        said.append(f"To record next: {file.next_experiment.why}.")
    if not file.kept_aside:
        said.append(
            "There is one record only: the gaps are those of what was fitted itself, and fall further than another's would."
        )
    return said


def _of_verdict(file: GapFile, held: Shrink | None, rest: Leftover, titles: Mapping[str, str]) -> list[str]:
    if file.verdict == "not_converged":
        return [
            "There is no answer: the fit of the model to these records did not come to its end (one more step promises a log "
            f"evidence of {file.promised:.0f} more).",
            "Let its numbers begin nearer to what they may be, state their sizes, or cut the records.",
        ]
    if file.verdict == "no_gap":
        if not is_open(file):
            said = [f"The model explains these records to within their noise (probability {file.p_no_gap:.2f})."]
        else:
            said = [
                f"No gap is shown, nor excluded: that nothing is missing has a probability of {file.p_no_gap:.2f} only."
            ]
        if file.ranking:
            first = file.ranking[0]
            said.append(
                f"The nearest thing to a gap would be {_titled(first.effects, titles)} (probability {first.probability:.2f})."
            )
        return said
    if file.verdict == "unknown":
        said = [f"Something is missing that none of the effects explains (probability {file.p_unknown:.2f})."]
        return [*said, _left_over(rest) if rest.log_evidence > NOTABLE else _placed(file)]
    return _named(file, held, rest, titles)


def _named(file: GapFile, held: Shrink | None, rest: Leftover, titles: Mapping[str, str]) -> list[str]:
    row = file.ranking[0]
    inexact = file.verdict == "form_not_exact"
    form = ", in a form that is not exactly this one" if inexact else ""
    said = [
        f"The model misses {_titled(row.effects, titles)}{form} (probability {row.named:.2f}). It lies in: {file.where.stage}."
    ]
    numbers = ", ".join(f"{k} {v.value:.3g} +- {v.std:.2g}" for k, v in row.parameters.items())
    said.append(f"Its size: {numbers}{STILL_MOVING if file.promised > CONVERGED_GAIN else ''}.")
    if held is not None and held.before > 1:
        low, high = row.shrink_interval
        on = "records kept aside" if file.kept_aside else "fitted record itself"
        said.append(
            f"With it, the gap on the {on} falls from {row.gap_before:.2f} to {row.gap_after:.2f} sigma "
            f"({100 * row.shrink:.0f} %, interval {100 * low:.0f}-{100 * high:.0f})."
        )
    if inexact:
        said.append(_left_over(rest))
    twins = [t for t in file.indistinguishable if t[0] in row.effects]
    if twins:
        said.append(f"These records do not tell it from {' or '.join(_titled([n], titles) for n in twins[0][1:])}.")
    said.append(row.cure)
    before, after = file.derivatives.get("before", {}), file.derivatives.get("after", {})
    bias = {k: before[k].value / after[k].value - 1 for k in after if after[k].value}
    worst = max(bias, key=lambda k: abs(bias[k]), default="")
    if worst and abs(bias[worst]) >= CHANGED:
        said.append(f"Left out, it biases the model's numbers by up to {abs(100 * bias[worst]):.0f} % ({worst}).")
    return said


def _placed(file: GapFile) -> str:
    place = file.where
    stage = max(place.share, key=lambda k: place.share[k]) if place.share else "no stage"
    return (
        f"It shows most in: {stage}, from {place.span_s[0]:.3g} to {place.span_s[1]:.3g} s, at {place.band_hz[0]:.3g} to "
        f"{place.band_hz[1]:.3g} Hz."
    )


def _left_over(rest: Leftover) -> str:
    if rest.log_evidence <= NOTABLE:
        return "What is left over stands out nowhere: it goes with the motion."
    if rest.disagree:
        return DISAGREE.format(rest.run)
    at = f"at {rest.band_hz[0]:.3g} Hz in all records" if rest.band_hz else ""
    at = f"in {rest.run}, from {rest.span_s[0]:.3g} to {rest.span_s[1]:.3g} s" if rest.span_s else at
    return f"What is left over stands out {at}; look for what happens there."


def _titled(names: Sequence[str], titles: Mapping[str, str]) -> str:
    return " and ".join(titles.get(name) or name for name in names)


__all__ = ["sentences"]
