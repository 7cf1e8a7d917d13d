"""A fault in words, with its size and uncertainty."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ...record.check_file import FoundFault
from ...record.results import Measured
from .check import Check
from .faults import Scored


def found_fault(
    check: Check, scored: Scored, points: Sequence[str], marks: Sequence[str], runs: Sequence[str]
) -> FoundFault:
    """The result file's form of a fault.

    Parameters
    ----------
    check : of the set-up
    scored : the fault with its score
    points, marks, runs : names
    """
    fault = scored.fault
    item = ""
    if fault.kind == "datum point":
        item = points[fault.item]
    elif fault.kind in ("height of a mark", "place of a mark"):
        item = marks[fault.item]
    elif fault.extra is not None:
        item = runs[fault.item]
    sizes = sizes_of(check, scored)
    span = None
    if fault.extra is not None and fault.kind != "datum point":
        begin, end = fault.extra.span_s
        span = (float(begin), float(end if np.isfinite(end) else begin))
    return FoundFault(
        kind=fault.kind,
        item=item,
        evidence=float(scored.evidence),
        sizes=sizes,
        span_s=span,
        sentence=_sentence(check, fault.kind, item, sizes, span),
    )


def sizes_of(check: Check, scored: Scored) -> dict[str, Measured]:
    """A fault's numbers with their standard deviations: departures from what is stated.

    Parameters
    ----------
    check : of the set-up
    scored : the fault with its score
    """
    solution = scored.solution
    if solution is None:
        return {}
    names = list(check.bundle.names)
    if scored.fault.extra is None:
        columns = {name: names.index(name) for name in scored.fault.released}
    else:
        which = {"point": ("u_px", "v_px"), "turn": ("right", "down", "ahead"), "slack": ("shortest",)}
        columns = {name: len(names) + i for i, name in enumerate(which[scored.fault.extra.kind])}
    return {
        name: Measured(value=float(solution.theta[c]), std=float(np.sqrt(solution.covariance[c, c])))
        for name, c in columns.items()
    }


def _mm(m: Measured, digits: int = 1) -> str:
    return f"{1e3 * abs(m.value):.{digits}f} +- {1e3 * m.std:.{digits}f} mm"


def _sentence(check: Check, kind: str, item: str, sizes: dict[str, Measured], span: tuple[float, float] | None) -> str:
    first = next(iter(sizes.values()), None)
    if first is None:
        return kind
    if kind == "lens":
        stated = check.bundle.rig.lens.distortion[0]
        return (
            f"the lens: k1 is {stated + first.value:+.4f} +- {first.std:.4f}, stated {stated:+.4f}; calibrate it again"
        )
    if kind.startswith("lens"):
        parts = ", ".join(f"{name} by {m.value:+.4g} +- {m.std:.2g}" for name, m in sizes.items())
        return f"{kind} off: {parts}; calibrate the lens again"
    if kind == "deck height":
        way = "lower" if first.value > 0 else "higher"
        return f"the marks lie {_mm(first)} {way} than depth_m says"
    if kind == "height of a mark":
        way = "lower" if first.value > 0 else "higher"
        return f"mark {item} lies {_mm(first)} {way} than its depth_m says"
    if kind == "place of a mark":
        parts = ", ".join(
            f"{name.split()[0]} by {1e3 * m.value:+.1f} +- {1e3 * m.std:.1f} mm" for name, m in sizes.items()
        )
        return f"mark {item} stands elsewhere on deck than body_m says: {parts}"
    if kind.startswith("datum ") and kind != "datum point":
        parts = ", ".join(
            f"{name.split()[1]} by {100 * m.value:+.2f} +- {100 * m.std:.2f} %" for name, m in sizes.items()
        )
        return f"the datum points stand elsewhere than tank_m says: {parts}; measure them again"
    if kind == "datum point":
        u, v = sizes["u_px"], sizes["v_px"]
        return (
            f"datum point {item} was picked {np.hypot(u.value, v.value):.1f} px off (u {u.value:+.1f} +- {u.std:.1f}, "
            f"v {v.value:+.1f} +- {v.std:.1f}), or its tank_m is wrong"
        )
    if kind == "camera turned":
        size = np.degrees(np.sqrt(sum(m.value**2 for m in sizes.values())))
        when = f" at {span[0]:.2f} s" if span else ""
        return f"the camera turned by {size:.2f} degrees{when} in {item}; cut the run there, or let datum points be tracked"
    if kind == "slack line":
        when = f" from {span[0]:.1f} to {span[1]:.1f} s" if span else ""
        return f"the line was slack{when} in {item}: the tow point came {_mm(first)} nearer to the post than a taut line lets it"
    way = "more" if first.value > 0 else "less"
    what = {
        "line length": "the line is {} {} than line_length_m says",
        "tow point": "the tow point lies {} {} ahead of LCG than tow_point_m says",
        "post ahead": "the tow post stands {} {} ahead than post_m says",
    }[kind]
    if kind == "line length":
        way = "longer" if first.value > 0 else "shorter"
    return what.format(_mm(first), way)
