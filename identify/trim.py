"""Trim: runs of unlike trim are not one hull (4.4).

The thesis's figure 7.29 (runs of table 7.1): with 2 degrees of stern trim the model swings little and is damped, level it hardly
settles, with 1 degree by the bow it sheers off.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from ..record.errors import EstimationError

TRIM_TOLERANCE_RAD = 5e-4
"""Trims that lie nearer (0.03 degrees) count as one: 1.3 mm of draught over a model of 2.66 m, what two draught marks read to about
a millimetre leave open. Y_v grows with the trim by 2/3 of its share of the draught (Inoue): 0.8 % at 0.116 m of draught, about a
campaign's own error (README)."""


def same_trim(trims: Mapping[str, float | None]) -> list[str]:
    """What a reader must know of the trims of runs that are fitted together.

    Parameters
    ----------
    trims : run name -> trim_rad, by the stern positive; None: not stated

    Raises
    ------
    EstimationError : two of them lie farther apart than ``TRIM_TOLERANCE_RAD``

    Examples
    --------
    >>> same_trim({"a": 0.0075, "b": 0.0075, "c": None})
    ['trim is stated for a, b only (0.43 degrees by the stern); c is taken to float alike']
    """
    said = {name: trim for name, trim in trims.items() if trim is not None}
    if not said:
        return []
    values = np.array(list(said.values()))
    if np.ptp(values) > TRIM_TOLERANCE_RAD:
        groups = trim_groups(list(trims.values()))
        names = list(trims)
        listed = "; ".join(
            f"{trim_words(trims[names[group[0]]])}: {', '.join(names[k] for k in group)}" for group in groups
        )
        raise EstimationError(
            f"the runs are not of one hull: their trims differ by {np.degrees(np.ptp(values)):.2g} degrees, and the derivatives "
            f"change with trim ({listed}); fit each trim apart"
        )
    silent = [name for name in trims if name not in said]
    if not silent:
        return []
    return [
        f"trim is stated for {', '.join(said)} only ({trim_words(float(values.mean()))}); {', '.join(silent)} "
        f"{'is' if len(silent) == 1 else 'are'} taken to float alike"
    ]


def trim_groups(trims: list[float | None]) -> list[list[int]]:
    """Which runs count as one hull: those whose trims hang together within ``TRIM_TOLERANCE_RAD``, by rising trim.

    Runs that state none go with the others where these make one group, else they are a group of their own, the last.

    Parameters
    ----------
    trims : of each run, rad; None: not stated

    Returns
    -------
    indices of the runs of each group

    >>> trim_groups([0.0, 0.0175, 0.0002, None])
    [[0, 2], [1], [3]]
    >>> trim_groups([0.0, 0.0002, None])
    [[0, 1, 2]]
    """
    order = sorted((trim, k) for k, trim in enumerate(trims) if trim is not None)
    groups: list[list[int]] = []
    first = -np.inf
    for trim, k in order:
        if trim - first > TRIM_TOLERANCE_RAD:
            groups.append([])
            first = trim
        groups[-1].append(k)
    silent = [k for k, trim in enumerate(trims) if trim is None]
    if silent and len(groups) == 1:
        return [sorted(groups[0] + silent)]
    return [sorted(group) for group in groups] + ([silent] if silent else [])


def trim_words(trim_rad: float | None) -> str:
    """ "0.43 degrees by the stern" """
    if trim_rad is None:
        return "not stated"
    degrees = float(np.degrees(trim_rad))
    if abs(degrees) < 0.005:
        return "level"
    return f"{abs(degrees):.2f} degrees by the {'stern' if degrees > 0 else 'bow'}"


__all__ = ["TRIM_TOLERANCE_RAD", "same_trim", "trim_groups", "trim_words"]
