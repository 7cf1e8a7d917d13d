"""gap.json in plain words."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from ..record.gap_file import GapFile, RankedEffects
from .effects import Effect
from .inference.evidence import CONVERGED_GAIN
from .inference.held_out import Shrink
from .inference.scan import Leftover
from .sizes import sizes_of, symbol
from .tow.numbers import BESIDE

OPEN = 0.6
"""Below this probability no gap is a verdict for want of a better one."""
SWALLOWED, SEEN, SMALLEST = 2.0, 1e-3, 1e-4
"""Random forces are spoken of where they are so many times larger without the headline, and at least so large there (N, N m); what
they are with it counts as at least the last. Choices."""
EXCLUDED = 3.0
"""Log evidence by which a form must fall short of the best one to be excluded, odds of 20 to 1."""
SECOND = 10.0
"""Log evidence from which an effect that would take more beside the headline is spoken of, though not named: above any prior."""
NOTABLE = 5.0
"""Log evidence from which what is left over is described by its place instead of the gap: a choice, odds of 150 to 1."""


def is_open(file: GapFile) -> bool:
    """No gap is said for want of proof, not because nothing seems to be missing."""
    return file.verdict == "no_gap" and file.p_no_gap < OPEN


def is_unseen(file: GapFile) -> bool:
    """Effects are named, but on the runs that are judged the gap does not shrink with them."""
    return file.verdict in ("effect", "form_not_exact") and bool(file.ranking) and file.ranking[0].shrinks is False


STILL_MOVING = "; its fit has not come to its end, so that sizes and gap may be further off than this says"
DISAGREE = (
    "The runs do not agree about the numbers that they share: {} asks for others, most of all. What is missing acts otherwise in "
    "each of them; look for what differs between them."
)
ALONE = (
    "No other run was there to be kept aside: the gaps are those of what was fitted itself, and fall further than another run's "
    "would. Much of what one run has its derivatives alone can take up: an effect counts as found when a second tow, of another "
    "tow point, line or speed, shows it, too."
)


def sentences(
    file: GapFile,
    held: Shrink | None,
    rest: Leftover,
    titles: Mapping[str, str] | None = None,
    like: Effect | None = None,
) -> list[str]:
    """The summary in plain words; ``titles``: of the effects by name (default: the name).

    Parameters
    ----------
    file : gap.json
    held : how far the gap shrinks, or None
    rest : what the best hypothesis leaves
    titles : of the effects, by name; None: their names
    like : the free form that comes nearest to what is in no library
    """
    said = _summary(file, held, rest, titles or {})
    if file.verdict == "unknown" and like is not None and like.title:
        said.append(f"It looks like {like.title}. {like.cure}")
    return said if file.kept_aside else [*said, ALONE]


def _summary(file: GapFile, held: Shrink | None, rest: Leftover, titles: Mapping[str, str]) -> list[str]:
    if file.verdict == "no_gap":
        doubted = is_open(file)
        said = [f"The simulator explains these runs to within their noise (probability {file.p_no_gap:.2f})."]
        if doubted:
            said = [
                f"No gap is shown, nor excluded: that nothing is missing has a probability of {file.p_no_gap:.2f} only."
            ]
        if file.ranking:
            first = file.ranking[0]
            may = "It may miss" if doubted else "The nearest thing to a gap would be"
            said.append(f"{may} {_titled(first.effects, titles)} (probability {first.probability:.2f}).")
        if doubted and file.next_measurement is not None:
            said.append(f"Without a tow: measure {file.next_measurement.why}")
        if doubted and file.next_run is not None:
            said.append(f"To be surer: {file.next_run.why}.")
        return said
    if file.verdict == "not_converged":
        return [
            "There is no answer: the fit of the simulator to these runs did not come to its end. One more step still promises a "
            f"log evidence of {file.promised:.0f} more, so that what is left over may be the fit's and no gap.",
            "Let its numbers begin nearer to what they may be, state their sizes, or cut the records where the motion leaves what "
            "the simulator can follow; a simulator that jumps where its numbers change by little is never fitted.",
        ]
    if file.verdict == "unknown":
        place = file.where
        said = [
            f"There is a gap that no effect or pair of effects in the library explains (probability {file.p_unknown:.2f})."
        ]
        if rest.log_evidence > NOTABLE:
            return [*said, _left_over(rest)]
        return [
            *said,
            f"It shows most in {max(place.share, key=lambda k: place.share[k])}, from {place.span_s[0]:.0f} to "
            f"{place.span_s[1]:.0f} s, at {place.band_hz[0]:.2f} to {place.band_hz[1]:.2f} Hz.",
        ]
    row = file.ranking[0]
    inexact = file.verdict == "form_not_exact"
    stage = file.where.stage
    side = {
        "sway": " in the sway equation",
        "yaw": " in the yaw equation",
        "line": " in the line",
        "camera": " in the camera",
    }
    form = ", in a form that is not exactly the library's" if inexact else ""
    missed = f"{_titled(row.effects, titles)}{side.get(stage, '')}{form} (probability {row.named:.2f})"
    said = [f"Your simulator misses {missed}{', by the fitted runs alone' if is_unseen(file) else ''}."]
    numbers = ", ".join(size.text for size in sizes_of(row.parameters, row.units))
    said.append(f"Its size: {numbers}{STILL_MOVING if file.promised > CONVERGED_GAIN else ''}.")
    on = "runs kept aside" if file.kept_aside else "fitted run itself"
    if held is not None and is_unseen(file):
        said.append(
            f"No gap on the {on} shrinks with it ({row.gap_before:.2f} sigma without it, {row.gap_after:.2f} with it): another tow "
            "would show whether it is there again."
        )
    elif held is not None and held.before > 1:
        low, high = row.shrink_interval
        said.append(
            f"With it, the gap on the {on} falls from {row.gap_before:.2f} to {row.gap_after:.2f} sigma "
            f"({100 * row.shrink:.0f} %, interval {100 * low:.0f}-{100 * high:.0f})."
        )
        if held.alone and file.kept_aside:
            said.append(
                f"What no other run tells ({held.alone} of its numbers: of what came once, when and how much) is fitted to the run "
                "itself, not kept aside."
            )
    if (swallowed := _swallowed(file)) >= SWALLOWED:
        said.append(f"Without it, random forces {swallowed:.0f} times as large would have to be believed.")
    if inexact:
        said.append(_left_over(rest))
    if second := _second(file, titles):
        said.append(second)
    if row.form:
        said.append(_forms(row))
    apart = file.next_measurement
    twins = [t for t in file.indistinguishable if t[0] in row.effects]
    if twins:
        others = " or ".join(_titled([n], titles) for n in twins[0][1:])
        cure = f"; {file.next_run.why.split(':')[0]} would" if file.next_run is not None else ""
        said.append(f"It cannot be told from {others} with these runs{cure}.")
    elif file.next_run is not None:
        said.append(f"To be surer: {file.next_run.why}.")
    if apart is not None and len(file.set95) > 1:
        said.append(f"Without a tow: measure {apart.why}")
    if row.cure not in said[-1]:
        said.append(row.cure)
    changed = _changed(file)
    if changed:
        said.append(changed)
    return said


def _swallowed(file: GapFile) -> float:
    """How much larger random forces are without the headline, the larger of side force and moment; 0: not known."""
    shares = [
        file.noise_without[k] / max(file.noise[k], SMALLEST)
        for k in ("side_n", "moment_n_m")
        if k in file.noise_without
    ]
    return max(shares, default=0.0) if max(file.noise_without.values(), default=0.0) > SEEN else 0.0


def _second(file: GapFile, titles: Mapping[str, str]) -> str:
    """What would take more beside a single effect, but no more than that one's own form may leave over; empty: nothing."""
    row = file.ranking[0]
    pairs = [r for r in file.ranking[1:] if len(row.effects) == 1 and set(r.effects) > set(row.effects)]
    best = max(pairs, key=lambda r: r.log_evidence, default=row)
    more = best.log_evidence - row.log_evidence
    if more < SECOND:
        return ""
    other = _titled([name for name in best.effects if name not in row.effects], titles)
    return f"Beside it {other} would take some more (log evidence {more:.0f}); the form of what is named may leave as much over."


def _left_over(rest: Leftover) -> str:
    if rest.log_evidence <= NOTABLE:
        return "What is left over stands out nowhere: it follows the motion, as a force of another form would."
    if rest.disagree:
        return DISAGREE.format(rest.run)
    at = f"at {rest.band_hz[0]:.2f} Hz in all runs" if rest.band_hz else ""
    at = f"in {rest.run}, from {rest.span_s[0]:.0f} to {rest.span_s[1]:.0f} s" if rest.span_s else at
    return f"What is left over stands out {at}; look for what happens there."


def _forms(row: RankedEffects) -> str:
    """Which form fits best, and which are excluded."""
    out = [name or "the plain one" for name, log in row.forms.items() if log < -EXCLUDED]
    near = [name or "the plain one" for name, log in row.forms.items() if log >= -EXCLUDED]
    said = f"Of its forms fits best: {row.form}"
    if near:
        said += f"; as well as that: {', '.join(near)}"
    return f"{said}; excluded: {', '.join(out)}." if out else f"{said}."


def _titled(names: Sequence[str], titles: Mapping[str, str]) -> str:
    return " and ".join(titles.get(name) or name for name in names)


def _changed(file: GapFile) -> str:
    """What the unmodelled effect had done to the derivatives."""
    before, after = file.derivatives.get("before", {}), file.derivatives.get("after", {})
    bias = {k: 100 * (before[k].value / after[k].value - 1) for k in after if after[k].value and k not in BESIDE}
    if not bias:
        return ""
    worst = max(bias, key=lambda k: abs(bias[k]))
    return (
        f"Left out, it biases the derivatives by up to {abs(bias[worst]):.0f} % ({symbol(worst)})."
        if abs(bias[worst]) >= 1
        else ""
    )
