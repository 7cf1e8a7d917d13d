"""The law of a campaign: searched where something is missing, written as an equation, as an effect and for a scenario."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from ..__version__ import __version__
from ..diagnose.effects import Effect
from ..diagnose.effects.camera import ROLL as MARKER_ROLL
from ..diagnose.gap import Diagnosed
from ..diagnose.inference.refining import CLEAR
from ..diagnose.law.answer import TOLD, Law, Searched
from ..diagnose.law.choose import Groups
from ..diagnose.law.search import searched
from ..diagnose.law.terms import AHEAD, HEEL, coefficients_of, text_of
from ..diagnose.tow.towed import TowSimulator
from ..record.files import write_text
from ..record.law_file import FreeForce, GoesWith, LawFile, LawRow, LawTerm
from ..record.results import Measured, write_result
from ..record.threads import one_thread
from .diagnosing import concluded_runs, write_model

Progress = Callable[[str, int, int | None], None]
SEEN_ONLY = ("camera", "clock")
"""Stages of faults that move nothing: no law is looked for beside them, but for a roll, which something heels."""
ACTING = {
    "Y": "a side force",
    "N": "a moment",
    "Y and N": "a side force and a moment",
    AHEAD: "a resistance beyond the straight tow's",
    HEEL: "a heel of the model, under marks above its roll axis,",
}
"""Where a term acts, in words."""
FIELD_IS = {AHEAD: " is a resistance that", HEEL: " is a heel of the model that"}
"""Where a force without a form acts, in words; elsewhere nothing is said."""
UNUSED = 0.01
"""Usual size of a coefficient where a law does not act: it has none there."""
NONE = 1e-3
"""A law below this probability is not told."""


@dataclass(frozen=True)
class LawAnswer:
    """Whether a law was searched, and what came of it.

    Attributes
    ----------
    verdict : "law", "form_open", "field", "no_gap", "other", "unknown" of the search, or "not_searched"
    why : in words, where there is no law
    searched : the search, None where there was no reason for one
    instead_of : effects of the library that the diagnosis names, and a law explains better
    """

    verdict: str
    why: str
    searched: Searched | None = None
    instead_of: str = ""


def law_of(found: Diagnosed, progress: Progress | None = None) -> LawAnswer:
    """Search the law that a campaign misses.

    Parameters
    ----------
    found : of ``diagnose_folders``
    progress : is told what is done
    """
    file, best = found.diagnosis.file, found.diagnosis.best
    named = best.effects if best is not None else ()
    # beside a force, what is seen otherwise may be what the force's form leaves: then a law is held against both
    if file.verdict == "effect" and all(map(_seen_only, named)):
        return LawAnswer("not_searched", f"{_titled(named)}: no force on the hull, and no law of it")
    simulator = found.diagnosis.inference.simulator
    assert isinstance(simulator, TowSimulator)
    say = None if progress is None else lambda text, done, total: progress(f"law: {text}", done, total)
    names = len({effect.name for effect in found.library})
    with one_thread():
        answer = searched(
            found.diagnosis,
            names,
            lambda ranking: concluded_runs(found.diagnosis, ranking, found.library, found.held, say),
            lambda text: say(text, 0, None) if say is not None else None,
            found.held,
        )
    return LawAnswer(answer.verdict, _no_law(answer), answer, _titled(named) if answer.verdict == "law" else "")


def _seen_only(effect: Effect) -> bool:
    return effect.stage in SEEN_ONLY and effect.name != MARKER_ROLL.name


def _titled(effects: Sequence[Effect]) -> str:
    return " and ".join(effect.title or effect.name for effect in effects)


def _no_law(answer: Searched) -> str:
    if answer.verdict == "law":
        return ""
    if answer.verdict == "form_open":
        return _open(answer)
    if answer.verdict == "field" and answer.field is not None:
        what = f"what is missing{FIELD_IS.get(answer.field.acts, '')}"
        return f"{what} goes with {_groups(answer.field.groups)}, and no equation of the grammar says how"
    if answer.verdict == "other":
        return f"{' and '.join(answer.other)} explains these runs better than any law of the grammar"
    if answer.verdict == "no_gap":
        return "what the simulator leaves of these runs is noise: no law of the grammar explains more of it than chance would"
    rest = answer.diagnosis.ranking.rest
    if rest.log_evidence > 0 and rest.span_s:
        return (
            f"something happens once, in {rest.run} at {rest.span_s[0]:.0f}-{rest.span_s[1]:.0f} s: an event has no law"
        )
    return "no law of one or two terms of the grammar explains these runs"


def _open(answer: Searched) -> str:
    """Why a law is not told though laws are the best there is."""
    variables, share = answer.acts_with
    first = answer.laws[0].probability
    where = f"what is missing goes with {' and '.join(variables)} (probability {share:.2f}), and its form is not told: "
    if first < TOLD:
        return f"{where}no law has a probability of {TOLD:g}, the best {first:.2f}"
    return (
        f"{where}the best law ({first:.2f}) follows the runs kept aside less well than a force without a form, by "
        f"{answer.worse_aside:.1f} standard errors"
    )


def _groups(groups: Groups) -> str:
    """In words."""
    return " and ".join(" with ".join(group) for group in groups)


def law_file(answer: LawAnswer, inputs: dict[str, str]) -> LawFile:
    """law.json.

    Parameters
    ----------
    answer : of ``law_of``
    inputs : files behind the diagnosis
    """
    laws = [law for law in answer.searched.laws if law.probability >= NONE] if answer.searched else []
    seen = answer.searched.seen.ends if answer.searched else {}
    return LawFile(
        schema="towline/law",
        tool=__version__,
        inputs=inputs,
        verdict=answer.verdict,  # pyright: ignore[reportArgumentType]
        why=answer.why,
        p_law=answer.searched.p_law if answer.searched else 0.0,
        laws=[_row(law) for law in laws],
        field=_free_force(answer.searched),
        goes_with=[
            GoesWith(variables=[list(group) for group in groups], share=share)
            for groups, share in (answer.searched.goes_with if answer.searched else ())
            if share >= NONE
        ],
        seen=seen,
        sentences=_sentences(laws, answer),
    )


def _free_force(answer: Searched | None) -> FreeForce | None:
    if answer is None or answer.field is None:
        return None
    field = answer.field
    return FreeForce(
        variables=[list(group) for group in field.groups],
        acts=field.acts,  # pyright: ignore[reportArgumentType]
        probability=field.probability,
        shrink=None if np.isnan(field.shrink) else field.shrink,
    )


def _row(law: Law) -> LawRow:
    terms = [
        LawTerm(
            text=text,
            acts=acts,  # pyright: ignore[reportArgumentType]
            effect=effect.name,
            numbers={
                parameter.name: Measured(value=float(value), std=float(sd))
                for parameter, value, sd in zip(effect.parameters, numbers, sds, strict=True)
            },
            units={parameter.name: parameter.unit for parameter in effect.parameters if parameter.unit},
        )
        for (text, acts), effect, numbers, sds in zip(law.terms, law.effects, law.numbers, law.sd, strict=True)
    ]
    return LawRow(
        text=law.text,
        probability=law.probability,
        terms=terms,
        same=list(law.same),
        shrink=None if np.isnan(law.shrink) else law.shrink,
    )


def _sentences(laws: Sequence[Law], answer: LawAnswer) -> list[str]:
    searched = answer.searched
    if searched is None or answer.verdict not in ("law", "form_open", "field", "unknown"):
        return [answer.why[:1].upper() + answer.why[1:] + "."]
    if answer.verdict == "law" and laws:
        told = _of_the_law(laws, answer)
    else:
        told = [answer.why[:1].upper() + answer.why[1:] + "."]
        if answer.verdict == "field" and searched.field is not None:
            told += _shrinks(searched.field.shrink)
            told += [f"The nearest equation: {law.text} (probability {law.probability:.2f})." for law in laws[:1]]
        if answer.verdict == "form_open":
            told.append(f"Candidates: {', '.join(f'{law.text} ({law.probability:.2f})' for law in laws)}.")
            if searched.other:
                told.append(f"The library's {' and '.join(searched.other)} explains these runs, too.")
    surest, share = searched.goes_with[0]
    if answer.verdict != "unknown" or _worth_saying(searched):
        told.append(f"Without any equation, what is missing goes with {_groups(surest)} ({share:.2f} of the evidence).")
    next_run = searched.diagnosis.file.next_run
    if next_run is not None:
        told.append(f"The run that would tell most: {next_run.why}.")
    effects = laws[0].effects if answer.verdict in ("law", "form_open") and laws else _field_effects(searched)
    ends = {name: f"{name} {low:.3g} to {high:.3g}" for effect in effects for name, low, high in effect.reach}
    spans = ", ".join(ends[name] for name in sorted(ends))
    if spans:
        told.append(f"It is known for {spans} (dimensionless), and for nothing beyond.")
    return told


def _field_effects(searched: Searched) -> Sequence[Effect]:
    return (
        searched.field.fitted.hypothesis.effects if searched.verdict == "field" and searched.field is not None else ()
    )


def _worth_saying(searched: Searched) -> bool:
    """Whether a force without a form explains more than noise does."""
    base = searched.diagnosis.ranking.base
    return searched.field is not None and searched.field.fitted.log_evidence - base.log_evidence > CLEAR


def _shrinks(shrink: float) -> list[str]:
    return [] if np.isnan(shrink) else [f"With it the gap on runs kept aside falls by {100 * shrink:.0f} %."]


def _of_the_law(laws: Sequence[Law], answer: LawAnswer) -> list[str]:
    first = laws[0]
    what = " and ".join(f"{ACTING[acts]} that goes with {text}" for text, acts in first.terms)
    told = [f"What is missing is {what} (probability {first.probability:.2f})."]
    searched = answer.searched
    if searched is not None and searched.other:
        told.append(f"The library's {' and '.join(searched.other)} explains these runs about as well.")
    elif answer.instead_of:
        told.append(f"That explains these runs better than what the library has: {answer.instead_of}.")
    told += _shrinks(first.shrink)
    if first.same:
        told.append(f"As good over what these runs have seen: {', '.join(first.same)}.")
    others = [f"{law.text} ({law.probability:.2f})" for law in laws[1:] if law.probability > 0.05]
    if others:
        told.append(f"Nearly as good: {', '.join(others)}.")
    return told


def write_law(out: Path, found: Diagnosed, answer: LawAnswer, file: LawFile) -> list[Path]:
    """law.json; with a law also law.py, for ``--effects``, and law.toml, derivatives and law for a scenario.

    Parameters
    ----------
    out : folder
    found : of ``diagnose_folders``
    answer : of ``law_of``
    file : of ``law_file``
    """
    write_result(out / "law.json", file)
    written = [out / "law.json"]
    if answer.verdict != "law" or not file.laws or answer.searched is None:
        return written
    first = answer.searched.laws[0]
    write_text(out / "law.py", _python(first, file.sentences))
    write_model(out / "law.toml", replace(found, diagnosis=answer.searched.diagnosis), first.fitted)
    return [*written, out / "law.py", out / "law.toml"]


def _python(law: Law, sentences: Sequence[str]) -> str:
    lines = [f'"""{sentences[0]}', "", *sentences[1:], "", "Written by towline diagnose --law; give it to --effects."]
    lines += ['"""', "", "from towline.diagnose.law.terms import effect_of", ""]
    for k, effect in enumerate(law.effects, start=1):
        text = text_of(effect)
        sizes = dict.fromkeys("ynxk", UNUSED) | {p.name[0]: p.sd for p in coefficients_of(effect)}
        usual = [f"{sizes[channel]:.6g}" for channel in {AHEAD: "ynx", HEEL: "ynxk"}.get(effect.variant, "yn")]
        reach = {name: (float(f"{low:.6g}"), float(f"{high:.6g}")) for name, low, high in effect.reach}
        lines += [
            f"LAW_{k} = effect_of(",
            f"    {text!r},",
            f"    {effect.variant!r},",
            f"    sd=({', '.join(usual)}),",
            f"    reach={reach!r},",
            ")",
        ]
    return "\n".join([*lines, ""])


__all__ = ["LawAnswer", "law_file", "law_of", "write_law"]
