"""A fit as text and back, to the last bit: what was fitted need not be fitted again because its page was not drawn yet."""

from __future__ import annotations

import base64
import json
from dataclasses import fields, is_dataclass
from typing import Any

import numpy as np

from .colour.disturbance import Disturbance
from .fit import Fit
from .joint.arrow import Shares
from .joint.common import Common
from .joint.guess import Path
from .noise import Whitener

KNOWN = {kind.__name__: kind for kind in (Fit, Whitener, Common, Shares, Path, Disturbance)}
DTYPES = ("float64", "int64", "bool")


def fit_as_text(fit: Fit) -> str:
    """JSON: dataclasses by name, arrays as the bytes that they are."""
    return json.dumps(_plain(fit))


def fit_from_text(text: str) -> Fit:
    """The fit that ``fit_as_text`` wrote.

    Raises
    ------
    ValueError : it is none
    """
    try:
        found = _whole(json.loads(text))
    except (KeyError, TypeError, AttributeError, RecursionError) as error:
        raise ValueError(f"no fit: {error}") from None
    if not isinstance(found, Fit):
        raise ValueError("no fit")
    return found


def _plain(value: Any) -> Any:
    if is_dataclass(value):
        own = {one.name: _plain(getattr(value, one.name)) for one in fields(value)}
        return {"is": type(value).__name__, "holds": own}
    if isinstance(value, np.ndarray):
        content = base64.b64encode(np.ascontiguousarray(value).tobytes()).decode()
        return {"is": "array", "dtype": str(value.dtype), "shape": value.shape, "holds": content}
    if isinstance(value, dict):
        return {"is": "dict", "holds": [[key, _plain(one)] for key, one in value.items()]}
    if isinstance(value, (list, tuple)):
        return {"is": type(value).__name__, "holds": [_plain(one) for one in value]}
    return value.item() if isinstance(value, np.generic) else value


def _whole(plain: Any) -> Any:
    if not isinstance(plain, dict):
        return plain
    kind, holds = plain["is"], plain["holds"]
    if kind == "array":
        if plain["dtype"] not in DTYPES:
            raise ValueError(f"an array of {plain['dtype']}")
        flat = np.frombuffer(base64.b64decode(holds, validate=True), dtype=plain["dtype"])
        return flat.reshape(plain["shape"]).copy()
    if kind == "dict":
        return {key: _whole(one) for key, one in holds}
    if kind in ("list", "tuple"):
        found = [_whole(one) for one in holds]
        return found if kind == "list" else tuple(found)
    return KNOWN[kind](**{name: _whole(one) for name, one in holds.items()})


__all__ = ["fit_as_text", "fit_from_text"]
