"""Our own form of box files, entry by entry: what may be left out, what it means then, and what is wrong with others."""

import io
import json
from math import cos, sin

import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from bagassets.assets.boxes.files.box_files import read_json_boxes, read_parquet_boxes
from bagassets.assets.boxes.files.label import UnreadableLabelsError, as_text, box_label, compose, is_number
from bagassets.geometry.se3 import SE3

pytestmark = pytest.mark.once

LEAST = {"stamp_ns": 5, "category": "car", "center": [1, 2.5, 3], "size": [2, 4, 1.5]}


def file_of(*entries, **header):
    return json.dumps({"format": "bagassets-boxes", "version": 1, **header, "boxes": list(entries)}).encode()


def label(entry=LEAST, **header):
    (found,) = read_json_boxes(file_of(entry, **header))
    return found


class TestJson:
    def test_the_least_that_a_box_needs(self):
        box = label().box
        assert (box.stamp_ns, box.category, box.size_m) == (5, "car", (2.0, 4.0, 1.5))
        assert box.frame_SE3_box == SE3((1.0, 0.0, 0.0, 0.0), (1.0, 2.5, 3.0))
        assert (box.frame_id, box.track_id, box.attributes, box.score) == ("", "", (), 1.0)

    def test_all_that_it_may_have(self):
        rotation = [0.5, -0.5, 0.5, -0.5]
        more = {
            "frame": "/lidar",
            "track_id": 7,
            "rotation": rotation,
            "attributes": ["a", "b"],
            "score": 0.25,
        }
        box = label(LEAST | more, frame="map").box
        assert box.frame_SE3_box.rotation == tuple(rotation)
        assert (box.frame_id, box.track_id, box.attributes, box.score) == ("lidar", "7", ("a", "b"), 0.25)

    def test_yaw_turns_about_the_vertical_axis(self):
        assert label(LEAST | {"yaw": 0.5}).box.frame_SE3_box.rotation == pytest.approx(
            (cos(0.25), 0, 0, sin(0.25))
        )

    def test_the_frame_of_the_file_holds_for_boxes_without_one(self):
        assert label(LEAST, frame="/map").box.frame_id == "map"

    @pytest.mark.parametrize(
        ("change", "problem"),
        [
            ({"stamp_ns": 5.0}, "its stamp_ns is no whole number"),
            ({"stamp_ns": True}, "its stamp_ns is no whole number"),
            ({"stamp_ns": -1}, "its stamp_ns is no whole number"),
            ({"stamp_ns": 1 << 63}, "its stamp_ns is no whole number"),
            ({"category": 3}, "its category is no text"),
            ({"frame": None}, "its frame is no text"),
            ({"track_id": 1.5}, "its track_id is neither text nor a whole number"),
            ({"track_id": True}, "its track_id is neither text nor a whole number"),
            ({"center": [1, 2]}, "its center is no list of 3 numbers"),
            ({"size": [1, 2, "3"]}, "its size is no list of 3 numbers"),
            ({"rotation": [1, 0, 0]}, "its rotation is no list of 4 numbers"),
            ({"rotation": "1000"}, "its rotation is no list of 4 numbers"),
            ({"rotation": [1, 0, 0, 0], "yaw": 0.0}, "it has both rotation and yaw"),
            ({"yaw": "0"}, "its yaw is no number"),
            ({"score": True}, "its score is no number"),
            ({"attributes": "a"}, "its attributes are no list of texts"),
            ({"attributes": ["a", 1]}, "its attributes are no list of texts"),
            ({"colour": "red"}, "it has the unknown field colour"),
            ({"rotation": [2, 0, 0, 0]}, "its rotation is no unit quaternion"),
        ],
    )
    def test_what_is_wrong_is_said(self, change, problem):
        assert label(LEAST | change).problem == problem

    @pytest.mark.parametrize("name", LEAST)
    def test_what_is_required_is_named(self, name):
        assert (
            label({key: value for key, value in LEAST.items() if key != name}).problem == f"it has no {name}"
        )

    def test_an_entry_that_is_no_object(self):
        assert label([1]).problem == "it is no object"

    @pytest.mark.parametrize("stamp_ns", [0, (1 << 63) - 1])
    def test_the_first_and_the_last_time_there_is(self, stamp_ns):
        assert label(LEAST | {"stamp_ns": stamp_ns}).box.stamp_ns == stamp_ns

    @pytest.mark.parametrize(
        ("data", "reason"),
        [
            (b"[]", "is no box file"),
            (b'{"format": "other", "version": 1, "boxes": []}', "is no box file"),
            (b'{"format": "bagassets-boxes", "version": 2, "boxes": []}', "has version 2, 1 is known here"),
            (
                file_of(boxed=1),
                "has the unknown field boxed; known are format, version, frame, boxes, comment",
            ),
            (b'{"format": "bagassets-boxes", "version": 1, "boxes": {}}', "has no list `boxes`"),
            (file_of(frame=1), "`frame` is no text"),
            (b"\n\xff", "is not UTF-8 text"),
        ],
    )
    def test_a_file_of_another_form_is_refused(self, data, reason):
        with pytest.raises(UnreadableLabelsError, match=reason):
            list(read_json_boxes(data))

    def test_a_comment_and_a_byte_order_mark_do_no_harm(self):
        assert list(read_json_boxes(b"\xef\xbb\xbf" + file_of(comment="by hand"))) == []


COLUMNS = {"stamp_ns": 5, "category": "car", "x": 1.0, "y": 2.5, "z": 3.0, "qw": 1.0, "qx": 0.0, "qy": 0.0, "qz": 0.0,
           "width": 2.0, "length": 4.0, "height": 1.5}  # fmt: skip


def parquet(*rows):
    sink = io.BytesIO()
    pq.write_table(pa.Table.from_pylist(list(rows)), sink)
    return sink.getvalue()


class TestParquet:
    def test_a_row_is_what_an_entry_is(self):
        (found,) = read_parquet_boxes(parquet(COLUMNS))
        assert found.box == label().box
        more = {"frame": "/lidar", "track_id": 7, "attributes": ["a"], "score": 0.25}
        first, second = read_parquet_boxes(parquet(COLUMNS | more, COLUMNS))
        assert (first.box.frame_id, first.box.track_id, first.box.attributes, first.box.score) == (
            "lidar",
            "7",
            ("a",),
            0.25,
        )
        assert (second.box, second.line) == (label().box, 2)

    @pytest.mark.parametrize("name", COLUMNS)
    def test_a_column_that_is_missing_is_named(self, name):
        with pytest.raises(
            UnreadableLabelsError, match=f"lacks the column {name}; required are stamp_ns, category, x"
        ):
            list(read_parquet_boxes(parquet({key: value for key, value in COLUMNS.items() if key != name})))

    @pytest.mark.parametrize(
        ("row", "problem"),
        [
            ({"x": None}, "its x is empty"),
            ({"category": None}, "its category is empty"),
            ({"score": "high"}, "its score is no number"),
            ({"attributes": "a"}, "its attributes are no list of texts"),
            ({"qw": 2.0}, "its rotation is no unit quaternion"),
        ],
    )
    def test_what_is_wrong_with_a_row_is_said(self, row, problem):
        (found,) = read_parquet_boxes(parquet(COLUMNS | row))
        assert found.problem == problem

    def test_stamps_are_whole_numbers(self):
        with pytest.raises(UnreadableLabelsError, match="stamp_ns that is not of whole numbers"):
            list(read_parquet_boxes(parquet(COLUMNS | {"stamp_ns": 5.0})))

    def test_what_is_no_parquet_is_refused(self):
        with pytest.raises(UnreadableLabelsError, match="is no Parquet file"):
            list(read_parquet_boxes(b"PAR1"))

    @pytest.mark.parametrize(
        ("sound", "problem"), [(b"category", "is no Parquet file"), (b"carcarcar", "that is not UTF-8")]
    )
    def test_texts_that_are_not_utf8_are_refused(self, sound, problem):
        data = parquet(COLUMNS | {"category": "carcarcar"})
        assert sound in data
        with pytest.raises(UnreadableLabelsError, match=problem):
            list(read_parquet_boxes(data.replace(sound, b"\xff" * len(sound))))


class TestLabels:
    def test_half_a_character_is_a_problem(self):
        broken = box_label(3, [0, 0, 0], [1, 0, 0, 0], (1, 1, 1), track_id="\ud800", category="car")
        assert (broken.line, broken.problem) == (3, "a text in it has broken characters")

    @pytest.mark.parametrize("place", range(7))
    def test_numbers_are_finite(self, place):
        numbers = [0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0]
        numbers[place] = float("inf")
        found = box_label(1, numbers[:3], numbers[3:], (1, 1, 1), track_id="", category="car")
        assert found.problem == "its position or rotation is not finite"

    @pytest.mark.parametrize(("length", "sound"), [(1.09, True), (1.1, False), (0.9, True), (0.89, False)])
    def test_a_rotation_may_be_off_by_rounding(self, length, sound):
        found = box_label(1, [0, 0, 0], [length, 0, 0, 0], (1, 1, 1), track_id="", category="car")
        assert (found.problem is None) == sound

    def test_the_last_of_several_turns_is_made_first(self):
        quarter = 0.5**0.5
        about_x, about_z = (quarter, quarter, 0, 0), (quarter, 0, 0, quarter)
        # First a quarter about x, then one about z: y goes to z and stays there, x goes to y.
        turned = SE3(compose(about_z, about_x))
        assert turned.rotation_matrix.round(9).tolist() == [[0, 0, 1], [1, 0, 0], [0, 1, 0]]

    def test_the_line_that_is_not_utf_8_is_named(self):
        with pytest.raises(UnreadableLabelsError) as caught:
            as_text(b"one\ntwo\n\xfe")
        assert caught.value.line == 3

    @pytest.mark.parametrize(
        ("value", "number"),
        [
            (1, True),
            (-1.5, True),
            (True, False),
            ("1", False),
            (None, False),
            (10**300, False),
            (10**299, True),
        ],
    )
    def test_what_a_float_can_hold_is_a_number(self, value, number):
        assert is_number(value) == number
