"""Messages of any layout, and recordings of them without definitions, as ROS 2 wrote them before Iron."""

import sqlite3

import numpy as np
from rosbags.interfaces import Nodetype
from rosbags.rosbag2 import Writer
from rosbags.typesys import Stores, get_typestore

from bagassets.assets.inventory import make_inventory
from bagassets.recordings.inventory import Inventory
from bagassets.recordings.layouts import choice_of
from bagassets.recordings.open import open_recording
from bagassets.recordings.pack import PACK_FILE, Pack, PackedRecording
from bagassets.store.artifact import Artifact, ArtifactWriter

_NUMBERS = {"bool": np.bool_, "byte": np.uint8, "char": np.uint8, "octet": np.uint8}


def layout_of(msgtype, number=0):
    """Return one of the layouts that are possible without a definition, the likeliest first."""
    return choice_of(msgtype, "cdr", None, []).layouts[number]


def fill(layout, msgtype=None, **given):
    """Return a message of a layout; fields are given as nested dicts and lists, others are zero."""
    msgtype = msgtype or layout.msgtype
    fields = layout.types[msgtype][1]
    unknown = given.keys() - {name for name, _ in fields}
    assert not unknown, f"{msgtype} has no {unknown}"
    values = {name: _value(layout, description, given.get(name)) for name, description in fields}
    return layout.store.types[msgtype](**values)


def serialized(layout, message, **options):
    """Return the bytes of a message; the store of a layout only reads."""
    store = get_typestore(Stores.EMPTY)
    store.register(dict(layout.types))
    serialize = store.serialize_ros1 if layout.serialization == "ros1" else store.serialize_cdr
    return bytes(serialize(message, layout.msgtype, **options))


def _value(layout, description, given):
    kind, inner = description
    if kind == Nodetype.NAME:
        return fill(layout, inner, **(given or {}))
    if kind == Nodetype.BASE:
        if given is not None:
            return given
        return "" if inner[0] in {"string", "wstring"} else 0
    element, length = inner
    if given is None:
        given = [None] * (length if kind == Nodetype.ARRAY else 0)
    items = [_value(layout, element, item) for item in given]
    if element[0] != Nodetype.BASE or element[1][0] == "string":
        return items
    return np.array(items, dtype=_NUMBERS.get(element[1][0], element[1][0]))


def header(stamp_ns, frame):
    return {"stamp": {"sec": stamp_ns // 10**9, "nanosec": stamp_ns % 10**9}, "frame_id": frame}


def write_bare(path, messages):
    """Write a ROS 2 bag without definitions from (topic, layout, log time, message)."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with Writer(path, version=9) as writer:
        connections = {}
        for topic, layout, log_time_ns, message in messages:
            if topic not in connections:
                connections[topic] = writer.add_connection(topic, layout.msgtype, typestore=layout.store)
            writer.write(connections[topic], log_time_ns, serialized(layout, message))
    (database,) = path.glob("*.db3")
    with sqlite3.connect(database) as connection:
        connection.execute("DELETE FROM message_definitions")
    return path


def inventory_of(path, folder, message_definitions=(), limits=None):
    """Return the typed inventory of a recording, and its pack."""
    out = ArtifactWriter(folder)
    with open_recording(path, message_definitions, limits) as recording:
        summary = make_inventory(recording, out, size=1)
    artifact = Artifact(out.finish(summary), folder)
    value = artifact.read_json("inventory.json")
    inventory = Inventory.from_json(value)
    return inventory, PackedRecording(inventory, Pack(artifact.path(PACK_FILE)))
