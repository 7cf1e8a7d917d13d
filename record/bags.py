"""Recordings of messages as tables: MCAP (JSON, ROS 1 and 2) and ROS bags. A column is a topic and a field of its messages.

Topics come each at their own times. The rows are the messages of one topic; what the others say at those times is taken as each is
meant: an input straight between its messages or as it was, an output only where a message of its own is there.
"""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from .errors import InputError
from .files import refusal
from .names import lines_joined

Array = NDArray[np.float64]
Meant = Literal["output", "linear", "step"]
"""What a column is: measured, or an input that goes straight, or stays, between its messages."""
LOG_TIME = "log_time"
"""The clock that every recording has: when a message was recorded."""
BAG_BYTES = 8 << 30
"""Largest recording that is read: a choice."""
TOGETHER = 0.25
"""A message of another topic is of the row's time where it is within this share of a step of it."""
SOME = 0.5
"""At least this share of the rows must have one."""
SHOWN = 12
"""Topics or fields that an error names."""
NS = 1e-9
"""Seconds of a nanosecond."""


def is_bag(path: Path) -> bool:
    """Whether it is a recording of messages: FILE.mcap, FILE.bag, or a folder of ROS 2 with metadata.yaml.

    Parameters
    ----------
    path : of the file or folder
    """
    return path.suffix.lower() in (".mcap", ".bag") or (path / "metadata.yaml").is_file()


@dataclass
class _Topic:
    """Times of a topic's messages, and what its columns say."""

    times_s: list[float] = field(default_factory=list)
    values: dict[str, list[float]] = field(default_factory=dict)


def bag_columns(path: Path, meant: Mapping[str, Meant], clock: str = "") -> dict[str, Array]:
    """Columns of a recording, row by row at the times of the first output's topic (of the first column's where none is measured).

    Parameters
    ----------
    path : FILE.mcap, FILE.bag, or a ROS 2 folder
    meant : column ("/topic.field", "/topic.joint.position[1]") -> what it is
    clock : LOG_TIME, or the field of every message that has its time ("header.stamp"); empty: LOG_TIME, and no column of it

    Returns
    -------
    columns : name -> (n,); the clock's in seconds from the first row. NaN where an output was not measured at a row's time; rows
        at which an input is not known yet, or no more, are left out

    Raises
    ------
    InputError : it cannot be read, no topic begins a column, a field is not there or no number, topics that are measured are never
        recorded together, or the reader is not installed
    """
    if not meant:
        raise InputError(path, "column", "none is a topic's; at least one input or output is expected")
    messages = _mcap if path.suffix.lower() == ".mcap" else _bag
    if not path.is_dir() and (wrong := refusal(path, BAG_BYTES)) is not None:
        raise InputError(path, "", wrong)
    topics: dict[str, _Topic] = {}
    fields: dict[str, list[tuple[str, str]]] = {}
    try:
        for topic, log_ns, decoded in messages(
            path, lambda there: fields.update(_by_topic(path, meant, there)) or [*fields]
        ):
            own = topics.setdefault(topic, _Topic())
            message = decoded()
            stamp = _field(path, topic, message, clock) if clock not in ("", LOG_TIME) else log_ns
            own.times_s.append(_seconds(path, topic, clock, stamp))
            for column, name in fields[topic]:
                own.values.setdefault(column, []).append(_number(path, column, _field(path, topic, message, name)))
    except InputError:
        raise
    except Exception as error:  # of damaged bytes: whatever came of it
        told = lines_joined(str(error))[:120]
        raise InputError(
            path, "", f"cannot be read as a recording of messages ({told or type(error).__name__})"
        ) from None
    return _together(path, meant, fields, topics, clock)


def _by_topic(path: Path, meant: Mapping[str, Meant], there: Sequence[str]) -> dict[str, list[tuple[str, str]]]:
    """Topic -> its columns, with their fields."""
    found: dict[str, list[tuple[str, str]]] = {}
    for column in meant:
        of = [t for t in there if column.startswith((f"{t}.", f"{t}["))]
        if not of:
            raise InputError(path, f'column "{column}"', f"begins with no topic of it; found {_named(there)}")
        topic = max(of, key=len)
        found.setdefault(topic, []).append((column, column[len(topic) :].removeprefix(".")))
    return found


def _named(those: Sequence[str]) -> str:
    return (", ".join(sorted(those)[:SHOWN]) + (", ..." if len(those) > SHOWN else "")) or "none"


# the two readers -----------------------------------------------------------------------------------------------------

Messages = Iterator[tuple[str, int, Callable[[], Any]]]
"""Topic, nanoseconds at which it was recorded, what decodes it."""
Chosen = Callable[[Sequence[str]], Sequence[str]]
"""Topics of the recording -> those that are read."""


def _mcap(path: Path, chosen: Chosen) -> Messages:
    try:
        from mcap.reader import make_reader
    except ImportError:
        raise InputError(path, "", "an MCAP file needs mcap: pip install 'towline[bags]'") from None
    decoders: dict[int, Callable[[bytes], Any]] = {}
    with path.open("rb") as stream:
        reader = make_reader(stream)
        summary = reader.get_summary()
        if summary is not None:
            there = [channel.topic for channel in summary.channels.values()]
        else:  # a recording that was cut off has none
            there = list({channel.topic for _, channel, _ in reader.iter_messages()})
        for schema, channel, message in reader.iter_messages(topics=chosen(there)):
            if channel.id not in decoders:
                decoders[channel.id] = _decoder(path, schema, channel)
            decode = decoders[channel.id]
            yield channel.topic, message.log_time, lambda decode=decode, data=message.data: decode(data)


def _decoder(path: Path, schema: Any, channel: Any) -> Callable[[bytes], Any]:
    encoding = channel.message_encoding
    if encoding == "json":
        return json.loads
    if encoding not in ("cdr", "ros1") or schema is None or schema.encoding not in ("ros1msg", "ros2msg", "ros2idl"):
        kind = f"{encoding} of {schema.encoding}" if schema is not None else encoding
        raise InputError(path, f"topic {channel.topic}", f"is encoded as {kind}; json and ROS messages are read")
    typesys = _rosbags(path).typesys
    text, name = schema.data.decode(), schema.name if schema.name.count("/") == 2 else schema.name.replace("/", "/msg/")
    store = typesys.get_typestore(typesys.Stores.EMPTY)
    idl = schema.encoding == "ros2idl"
    store.register(typesys.get_types_from_idl(text) if idl else typesys.get_types_from_msg(text, name))
    read = store.deserialize_ros1 if encoding == "ros1" else store.deserialize_cdr
    return lambda data: read(data, name)


def _bag(path: Path, chosen: Chosen) -> Messages:
    highlevel, typesys = _rosbags(path).highlevel, _rosbags(path).typesys
    # older bags of ROS 2 say the names of their types only
    known = typesys.get_typestore(typesys.Stores.LATEST)
    with highlevel.AnyReader([path], default_typestore=known) as reader:
        topics = chosen([c.topic for c in reader.connections])
        those = [c for c in reader.connections if c.topic in topics]
        for connection, log_ns, data in reader.messages(those):
            yield connection.topic, log_ns, lambda c=connection, data=data: reader.deserialize(data, c.msgtype)


def _rosbags(path: Path) -> Any:
    try:
        import rosbags
        import rosbags.highlevel
        import rosbags.typesys
    except ImportError:
        raise InputError(path, "", "messages of ROS need rosbags: pip install 'towline[bags]'") from None
    return rosbags


# fields --------------------------------------------------------------------------------------------------------------


def _field(path: Path, topic: str, message: Any, name: str) -> Any:
    """A field of a message, of one in it, or of an array: "joint.position[1]"."""
    found = message
    for part in re.findall(r"[^.\[\]]+|\[\d+\]", name):
        if part[0] == "[":
            index = int(part[1:-1])
            if not hasattr(found, "__len__") or isinstance(found, str | Mapping) or index >= len(found):
                raise InputError(path, f"topic {topic}", f"{name!r}: there is no element {index}")
            found = found[index]
            continue
        there = (
            list(found) if isinstance(found, Mapping) else [n for n in getattr(found, "__dict__", {}) if n[0] != "_"]
        )
        if part not in there:
            raise InputError(path, f"topic {topic}", f"has no field {name!r}; at {part!r} there are {_named(there)}")
        found = found[part] if isinstance(found, Mapping) else getattr(found, part)
    return found


def _number(path: Path, column: str, value: Any) -> float:
    if value is None:
        return np.nan
    if isinstance(value, str) or np.ndim(value) or isinstance(value, Mapping) or not hasattr(value, "__float__"):
        raise InputError(
            path, f'column "{column}"', f"is no number but {type(value).__name__}; name a field or an element of it"
        )
    return float(value)


def _seconds(path: Path, topic: str, clock: str, stamp: Any) -> float:
    """Of nanoseconds since 1970 as recorded, a message's own seconds, or seconds and nanoseconds; to a quarter of a microsecond."""
    if clock in ("", LOG_TIME):
        return stamp * NS
    told = stamp if isinstance(stamp, Mapping) else getattr(stamp, "__dict__", {})
    for key in ("nanosec", "nsec", "nsecs", "nanos"):
        if key in told:
            whole = next((told[k] for k in ("sec", "secs", "seconds") if k in told), None)
            if whole is not None:
                return float(whole) + float(told[key]) * NS
    return _number(path, f"{topic}.{clock}", stamp)


# together ------------------------------------------------------------------------------------------------------------


def _together(
    path: Path, meant: Mapping[str, Meant], fields: Mapping[str, Any], topics: Mapping[str, _Topic], clock: str
) -> dict[str, Array]:
    of = {column: topic for topic, those in fields.items() for column, _ in those}
    for topic in fields:
        if topic not in topics:
            raise InputError(path, f"topic {topic}", "has no message")
    first = of[next((c for c, kind in meant.items() if kind == "output"), next(iter(meant)))]
    times = {topic: np.array(own.times_s) for topic, own in topics.items()}
    rows = _known_at(meant, of, times, times[first])
    kept = np.isin(times[first], rows)
    step = float(np.median(np.diff(rows))) if len(rows) > 1 else 1.0
    found: dict[str, Array] = {clock: rows - rows[0]} if clock else {}
    for column, kind in meant.items():
        t, values = times[of[column]], np.array(topics[of[column]].values[column])
        if of[column] == first:
            found[column] = values[kept]
            continue
        order = np.argsort(t, kind="stable")
        t, values = t[order], values[order]
        if kind == "linear":
            found[column] = np.interp(rows, t, values)
        elif kind == "step":
            found[column] = values[np.searchsorted(t, rows, side="right") - 1]
        else:
            after = np.clip(np.searchsorted(t, rows), 0, len(t) - 1)
            before = np.maximum(after - 1, 0)
            at = np.where(np.abs(t[before] - rows) < np.abs(t[after] - rows), before, after)
            near = np.abs(t[at] - rows) <= TOGETHER * step
            if near.mean() < SOME:
                raise InputError(
                    path,
                    f'column "{column}"',
                    f"{100 * near.mean():.0f} % of its messages are within a quarter of a step of those of {first}, which give the "
                    "rows; bring both to one clock",
                )
            found[column] = np.where(near, values[at], np.nan)
    return found


def _known_at(meant: Mapping[str, Meant], of: Mapping[str, str], times: Mapping[str, Array], rows: Array) -> Array:
    """Rows at which every input has begun, and none that goes straight to its next message has ended: it must be known."""
    kept = np.ones(len(rows), dtype=bool)
    for column, kind in meant.items():
        t = times[of[column]]
        if kind != "output":
            kept &= rows >= t.min()
        if kind == "linear":
            kept &= rows <= t.max()
    return rows[kept]


__all__ = ["LOG_TIME", "bag_columns", "is_bag"]
