"""Messages as records: MCAP of JSON and of ROS 2, bags of ROS 1 and 2, written by the libraries' own writers."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from towline.diagnose.own import Input, Model, Number, Output, State
from towline.diagnose.own.records import Record, read_records
from towline.record import InputError
from towline.record.bags import bag_columns

pytest.importorskip("mcap", reason="mcap, which reads MCAP, is not installed (the extra bags)")
pytest.importorskip("rosbags", reason="rosbags, which reads messages of ROS, is not installed (the extra bags)")
MODEL = Model(
    [State("angle", "rad")],
    [Input("torque", "N m"), Input("valve", "")],
    [Number("c", "1/s", 1.0)],
    [Output("angle", "rad")],
    lambda t, x, u, p: [u.torque - p.c * x.angle],
    name="arm.py",
)
STEP_NS, COUNT, BEGIN_NS = 20_000_000, 40, 1_700_000_000_000_000_000
TORQUE = np.cos(0.1 * np.arange(COUNT))
TOML = """
[clock]
column = "CLOCK"

[[column]]
name = "ANGLE"
role = "output"
of = "angle"
unit = "deg"
noise_sd = 0.1

[[column]]
name = "TORQUE"
role = "input"
of = "torque"
unit = "N mm"

[[column]]
name = "VALVE"
role = "input"
of = "valve"
hold = "step"
"""
Message = tuple[int, str, Any]


def messages() -> list[Message]:
    """Angles every 20 ms; torques 7 ms after each, straight between; a valve that is opened before and at 0.5 s."""
    angles = [
        (BEGIN_NS + k * STEP_NS, "/joint", {"position": [0.0, float(k)], "stamp": k * 0.02}) for k in range(COUNT)
    ]
    torques = [(BEGIN_NS + k * STEP_NS + 7_000_000, "/motor", {"torque": float(1e3 * k)}) for k in range(COUNT)]
    valves = [(BEGIN_NS + at, "/valve", {"open": value}) for at, value in ((-50_000_000, 0.0), (500_000_000, 1.0))]
    return sorted([*angles, *torques, *valves], key=lambda m: m[0])


def mcap_of(path: Path, rows: list[Message], encoding: str = "json") -> Path:
    from mcap.writer import Writer

    with path.open("wb") as stream:
        writer = Writer(stream)
        writer.start()
        schema = writer.register_schema(name="any", encoding="jsonschema", data=b"{}")
        channels = {
            topic: writer.register_channel(schema_id=schema, topic=topic, message_encoding=encoding)
            for topic in sorted({m[1] for m in rows})
        }
        for at, topic, message in rows:
            writer.add_message(channels[topic], log_time=at, publish_time=at, data=json.dumps(message).encode())
        writer.finish()
    return path


def toml_of(folder: Path, **columns: str) -> None:
    given = {
        "CLOCK": "log_time",
        "ANGLE": "/joint.position[1]",
        "TORQUE": "/motor.torque",
        "VALVE": "/valve.open",
    } | columns
    text = TOML
    for key, value in given.items():
        text = text.replace(f'"{key}"', f'"{value}"')
    (folder / "data.toml").write_text(text)


def checked(record: Record) -> None:
    """The first row has no torque yet: it is left out, and what is straight between 7 ms after and 13 ms before is known."""
    assert record.step_s == pytest.approx(0.02, rel=1e-6)
    np.testing.assert_allclose(record.values[:, 0], np.radians(np.arange(1, COUNT)), rtol=1e-6)
    np.testing.assert_allclose(record.inputs[:, 0], np.arange(1, COUNT) - 0.35, rtol=1e-5)
    np.testing.assert_array_equal(record.inputs[:, 1], np.arange(1, COUNT) >= 25)


def test_json_of_mcap_comes_in_the_models_words(tmp_path: Path) -> None:
    toml_of(tmp_path)
    _, records = read_records(MODEL, [mcap_of(tmp_path / "swing.mcap", messages())])
    checked(records.records[0])
    assert records.records[0].stays == (False, True)


def ros(store: Any, count: int = COUNT) -> list[tuple[int, str, str, Any]]:
    """The same as messages of ROS."""
    types = store.types
    time, header = types["builtin_interfaces/msg/Time"], types["std_msgs/msg/Header"]
    joint, number = types["sensor_msgs/msg/JointState"], types["std_msgs/msg/Float64"]
    empty = np.zeros(0)
    made = []
    for at, topic, message in messages():
        if topic == "/joint":
            seq = {"seq": 0} if "seq" in header.__dataclass_fields__ else {}
            head = header(stamp=time(sec=at // 10**9, nanosec=at % 10**9), frame_id="", **seq)
            row = joint(head, ["a", "b"], np.array(message["position"]), empty, empty)
            # recorded late, by up to a step: the header's stamp is the time
            made.append((at + (at // STEP_NS) % 3 * 6_000_000, topic, joint.__msgtype__, row))
        else:
            made.append((at, topic, number.__msgtype__, number(next(iter(message.values())))))
    return sorted(made, key=lambda m: m[0])


@pytest.mark.parametrize("kind", ["ros1", "sqlite3", "mcap"])
def test_bags_of_ros_come_alike(tmp_path: Path, kind: str) -> None:
    from rosbags.rosbag1 import Writer as Writer1
    from rosbags.rosbag2 import StoragePlugin
    from rosbags.rosbag2 import Writer as Writer2
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS1_NOETIC if kind == "ros1" else Stores.ROS2_HUMBLE)
    path = tmp_path / ("swing.bag" if kind == "ros1" else "swing")
    plugin = StoragePlugin.MCAP if kind == "mcap" else StoragePlugin.SQLITE3
    with Writer1(path) if kind == "ros1" else Writer2(path, version=9, storage_plugin=plugin) as writer:
        rows = ros(store)
        there = {t: writer.add_connection(t, of, typestore=store) for t, of in sorted({(m[1], m[2]) for m in rows})}
        for at, topic, name, message in rows:
            data = store.serialize_ros1(message, name) if kind == "ros1" else store.serialize_cdr(message, name)
            writer.write(there[topic], at, data)
    meant = {"/joint.position[1]": "output", "/motor.data": "linear", "/valve.data": "step"}
    found = bag_columns(path, meant, "log_time")  # pyright: ignore[reportArgumentType]
    assert np.abs(np.diff(found["log_time"]) - 0.02).max() > 0.005
    angles = bag_columns(path, {"/joint.position[1]": "output"}, "header.stamp")
    np.testing.assert_allclose(angles["header.stamp"], 0.02 * np.arange(COUNT), atol=1e-6)
    np.testing.assert_array_equal(angles["/joint.position[1]"], np.arange(COUNT))
    if kind == "mcap":
        # the file in the folder is one for itself
        (file,) = path.glob("*.mcap")
        again = bag_columns(file, {"/joint.position[1]": "output"}, "header.stamp")
        np.testing.assert_array_equal(again["/joint.position[1]"], np.arange(COUNT))


def test_two_topics_that_are_measured_are_rows_where_both_are_there(tmp_path: Path) -> None:
    """One every 20 ms, the other 3 ms later but for every third: nothing is made up between."""
    joints = [m for m in messages() if m[1] == "/joint"]
    other = [(at + 3_000_000, "/force", {"n": 2.0 * k}) for k, (at, *_) in enumerate(joints) if k % 3]
    rows = sorted([*joints, *other], key=lambda m: m[0])
    found = bag_columns(mcap_of(tmp_path / "two.mcap", rows), {"/joint.position[1]": "output", "/force.n": "output"})
    k = np.arange(COUNT)
    np.testing.assert_array_equal(found["/force.n"], np.where(k % 3 > 0, 2.0 * k, np.nan))
    late = [(at + 7_000_000, topic, message) for at, topic, message in other]
    path = mcap_of(tmp_path / "late.mcap", sorted([*joints, *late], key=lambda m: m[0]))
    with pytest.raises(InputError, match=r"0 % of its messages are within a quarter of a step of those of /joint"):
        bag_columns(path, {"/joint.position[1]": "output", "/force.n": "output"})


def test_what_is_wrong_with_a_recording_is_one_line(tmp_path: Path) -> None:
    good = mcap_of(tmp_path / "swing.mcap", messages())
    (tmp_path / "cut.mcap").write_bytes(good.read_bytes()[:200])
    (tmp_path / "text.bag").write_text("no bag")
    mcap_of(tmp_path / "packed.mcap", messages(), encoding="protobuf")
    for name, column, message in (
        (
            "swing.mcap",
            "/wheel.speed",
            r'swing\.mcap: column "/wheel\.speed": begins with no topic of it; found /joint, /motor, /valve',
        ),
        ("swing.mcap", "/motor.speed", r"swing\.mcap: topic /motor: has no field 'speed'; at 'speed' there are torque"),
        ("swing.mcap", "/joint.position[2]", r"topic /joint: 'position\[2\]': there is no element 2"),
        ("swing.mcap", "/joint.position", r'column "/joint\.position": is no number but list'),
        (
            "packed.mcap",
            "/motor.torque",
            r"topic /motor: is encoded as protobuf of jsonschema; json and ROS messages are read",
        ),
        ("cut.mcap", "/motor.torque", r"cut\.mcap: cannot be read as a recording of messages"),
        ("text.bag", "/motor.torque", r"text\.bag: cannot be read as a recording of messages"),
        ("absent.mcap", "/motor.torque", r"absent\.mcap: no such file"),
    ):
        with pytest.raises(InputError, match=message) as caught:
            bag_columns(tmp_path / name, {column: "output"}, "log_time")
        assert "\n" not in str(caught.value)
    toml_of(tmp_path, CLOCK="header.stamp")
    with pytest.raises(InputError, match=r"topic /valve: has no field 'header\.stamp'; at 'header' there are open"):
        read_records(MODEL, [good])
