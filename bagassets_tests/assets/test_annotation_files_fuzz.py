"""Readers of label files on whatever they may be given: labels or a named line, never a crash."""

import io
import json
import re

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from label_files import WRITERS, box_json

from bagassets.assets.boxes.collect import BoxCollector
from bagassets.assets.boxes.files.box_files import read_json_boxes, read_parquet_boxes
from bagassets.assets.boxes.files.json_text import entries, parse
from bagassets.assets.boxes.files.kitti import read_kitti_labels, read_kitti_tracklets
from bagassets.assets.boxes.files.label import UnreadableLabelsError
from bagassets.assets.boxes.files.nuscenes_tables import TableSet, read_table
from bagassets.assets.boxes.files.sustechpoints import read_sustechpoints
from bagassets.assets.boxes.files.times import named_frames, numbered_frames, read_times
from bagassets.assets.boxes.frames import BoxFrames
from bagassets.geometry.trajectory import Trajectory
from bagassets.recipe.model_annotations import AnnotationTopic

pytestmark = pytest.mark.once

JSON = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=8),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(max_size=5), inner, max_size=4),
    max_leaves=12,
)
READERS = {
    "boxes": read_json_boxes,
    "parquet": read_parquet_boxes,
    "sustechpoints": read_sustechpoints,
    "tracking": lambda data: read_kitti_labels(data, tracking=True),
    "objects": lambda data: read_kitti_labels(data, tracking=False),
    "tracklets": read_kitti_tracklets,
    "nuscenes": lambda data: read_table(TableSet(None), "sample_annotation.json", data),
    "times": lambda data: iter(read_times(data)[:0]),
}


@pytest.fixture(scope="module")
def samples(tmp_path_factory):
    """A sound file of each format."""
    folder = tmp_path_factory.mktemp("samples")
    for write in WRITERS.values():
        write(folder)
    return {
        "boxes": (folder / "a.boxes.json").read_bytes(),
        "parquet": (folder / "labels" / "a.parquet").read_bytes(),
        "sustechpoints": (folder / "a" / "label" / "000003.json").read_bytes(),
        "tracking": (folder / "a.txt").read_bytes(),
        "objects": next((folder / "label_2").iterdir()).read_bytes(),
        "tracklets": (folder / "tracklet_labels.xml").read_bytes(),
        "nuscenes": (folder / "v1.0-old" / "sample_annotation.json").read_bytes(),
        "times": (folder / "timestamps.txt").read_bytes(),
    }


def read_all(name, data):
    """Read a file; whatever is wrong with it has a line."""
    labels = None
    try:
        labels = list(READERS[name](data))
    except UnreadableLabelsError as err:
        line, reason = err.line, str(err)
    else:
        line, reason = 0, ""
    # Every kind of line end that a format may take for one.
    assert line <= len(data.decode(errors="replace").splitlines()) + 1
    assert bool(reason) == (labels is None)
    for label in labels or ():
        assert label.line >= 1
        assert label.box is None or label.problem is None
    collect([label.box for label in labels or () if label.box is not None])


def collect(boxes):
    """What readers give can be collected and written, every box accounted for."""
    nowhere = Trajectory(np.zeros(0, np.int64), np.zeros((0, 3)), np.zeros((0, 4)), 0, 0)
    collector = BoxCollector(
        BoxFrames("map", "base", {}, nowhere), {"": AnnotationTopic(topic="/boxes", frame="map")}
    )
    for box in boxes:
        collector.add(box)
    table = collector.finish().to_arrow()
    counts = collector.counts[""]
    assert counts.read == len(boxes) == counts.written + sum(counts.lost.values())
    assert table.num_rows == counts.written


@pytest.mark.parametrize("name", READERS)
@given(data=st.binary(max_size=200))
@settings(max_examples=40, deadline=None)
def test_any_bytes(name, data):
    read_all(name, data)


@pytest.mark.parametrize("name", READERS)
@given(cut=st.floats(0, 1), at=st.floats(0, 1), byte=st.binary(min_size=1, max_size=3))
@settings(max_examples=40, deadline=None)
def test_a_sound_file_that_was_cut_off_and_damaged(samples, name, cut, at, byte):
    data = samples[name]
    data = data[: max(1, round(cut * len(data)))]
    position = int(at * len(data))
    read_all(name, data[:position] + byte + data[position + len(byte) :])


@given(entry=st.dictionaries(st.sampled_from(["stamp_ns", "track_id", "category", "center", "size", "rotation", "yaw",
                                               "attributes", "score", "frame", "other"]), JSON))  # fmt: skip
@settings(max_examples=150, deadline=None)
def test_any_values_in_a_box(entry):
    sound = json.loads(box_json())["boxes"][0]
    read_all("boxes", box_json([sound, {**sound, **entry}, sound]).encode("utf-8", "surrogatepass"))


@given(psr=JSON, rest=st.dictionaries(st.sampled_from(["obj_id", "obj_type", "obj_attr"]), JSON))
@settings(max_examples=100, deadline=None)
def test_any_values_in_an_object_of_sustechpoints(psr, rest):
    read_all("sustechpoints", json.dumps([{"psr": psr, **rest}]).encode())
    axes = {"x": 1, "y": 2, "z": 3}
    parts = {"position": axes, "rotation": psr, "scale": axes}
    read_all("sustechpoints", json.dumps([{"psr": parts, "obj_type": "Car", **rest}]).encode())


@given(row=st.dictionaries(st.sampled_from(["sample_token", "instance_token", "attribute_tokens", "translation", "size",
                                            "rotation"]), JSON), stamp=JSON)  # fmt: skip
@settings(max_examples=100, deadline=None)
def test_any_values_in_a_row_of_nuscenes(row, stamp):
    tables = TableSet(None)
    for name in ("sample", "instance", "category"):
        rows = [
            {
                "token": "t",
                "timestamp": stamp if name == "sample" else 0,
                "category_token": "t",
                "name": "car",
            }
        ]
        tables.add(f"{name}.json", json.dumps(rows).encode())
    sound = {
        "sample_token": "t", "instance_token": "t", "attribute_tokens": [], "translation": [1, 2, 3], "size": [1, 1, 1],
        "rotation": [1, 0, 0, 0],
    }  # fmt: skip
    labels = list(read_table(tables, "sample_annotation.json", json.dumps([{**sound, **row}]).encode()))
    assert len(labels) == 1
    collect([label.box for label in labels if label.box is not None])


@given(column=st.sampled_from(["stamp_ns", "category", "x", "qw", "length", "track_id", "attributes", "score", "frame"]),
       values=st.sampled_from([[None], ["a"], [1], [1.5], [float("nan")], [["a"]], [[1]], [True], [1 << 40]]))  # fmt: skip
@settings(max_examples=100, deadline=None)
def test_any_types_of_parquet_columns(column, values):
    row = {"stamp_ns": 5, "category": "car", **dict.fromkeys(("x", "y", "z", "qx", "qy", "qz"), 0.0)}
    row |= {"qw": 1.0, "width": 1.0, "length": 2.0, "height": 1.0}
    sink = io.BytesIO()
    pq.write_table(pa.table({**{name: [value] for name, value in row.items()}, column: values}), sink)
    read_all("parquet", sink.getvalue())


class TestLines:
    @given(
        values=st.lists(JSON, max_size=6),
        indent=st.sampled_from([None, 0, 2]),
        key=st.sampled_from([None, "boxes"]),
    )
    @settings(max_examples=150, deadline=None)
    def test_entries_are_those_of_the_list_with_the_line_where_each_begins(self, values, indent, key):
        content = values if key is None else {"a": [1, {"boxes": 2}], "boxes": values, "z": "]"}
        text = "\n\n" + json.dumps(content, indent=indent)
        found = list(entries(text, key))
        assert json.dumps([value for _, value in found]) == json.dumps(values)
        lines = text.split("\n")
        for line, value in found:
            first = json.dumps(value, indent=indent).split("\n")[0].rstrip(" ")
            assert first[:1] in lines[line - 1]
        if indent is not None and values:
            assert [line for line, _ in found] == sorted({line for line, _ in found})

    @pytest.mark.parametrize(
        ("text", "line", "words"),
        [
            ("[1,\n2,\n,]", 3, "is no JSON"),
            ("", 1, "is no JSON"),
            ("[" + "9" * 5000 + "]", 0, "thousands of digits"),
            ("[" * 200_000, 0, "nested too deeply"),
        ],
    )
    def test_what_is_no_json_is_reported_with_its_line(self, text, line, words):
        with pytest.raises(UnreadableLabelsError, match=re.escape(words)) as caught:
            parse(text)
        assert caught.value.line == line


class TestTimes:
    def test_stamps_and_dates_are_read_to_the_nanosecond(self):
        text = b"1700000000123456789\n2011-09-26 13:02:25.964389445\n2011-09-26T13:02:25Z\n 2011-09-26 13:02:25.5 \r\n\n"
        second = 1_317_042_145
        assert read_times(text) == [
            1_700_000_000_123_456_789,
            second * 10**9 + 964_389_445,
            second * 10**9,
            second * 10**9 + 500_000_000,
        ]

    @pytest.mark.parametrize(
        "word", ["2011-13-26 13:02:25", "2011-09-26", "-5", "1.5", "9" * 19 + "1", "noon", "\n5"]
    )
    def test_what_is_no_time_is_reported_with_its_line(self, word):
        with pytest.raises(UnreadableLabelsError) as caught:
            read_times(f"1\n2\n{word}\n".encode())
        assert caught.value.line == 3

    @pytest.mark.parametrize(
        ("unit", "name", "stamp_ns"),
        [
            ("ns", "1700000000123456789.json", 1_700_000_000_123_456_789),
            ("us", "a__LIDAR_TOP__1700000000123456.json", 1_700_000_000_123_456_000),
            ("ms", "1700000000123.txt", 1_700_000_000_123_000_000),
            ("s", "1700000000.25.json", 1_700_000_000_250_000_000),
            ("s", "1700000000.1234567894.json", 1_700_000_000_123_456_789),
            ("s", "1700000000.json", 1_700_000_000_000_000_000),
            ("us", "a__LIDAR_TOP__1700000000123456.pcd.bin.json", 1_700_000_000_123_456_000),
            ("s", "1700000000.5.pcd.json", 1_700_000_000_500_000_000),
            ("ns", "first.json", None),
        ],
    )
    def test_names_give_times(self, unit, name, stamp_ns):
        assert named_frames(unit)(name, None) == stamp_ns
        assert named_frames(unit)(name, 3) is None  # a number inside the file is no name

    def test_frames_are_counted_from_the_first(self):
        frames = numbered_frames([10, 20, 30], first=5)
        assert [frames("", number) for number in (4, 5, 7, 8)] == [None, 10, 30, None]
        assert frames("cloud_000006.json", None) == 20
        assert frames("cloud.json", None) is None
