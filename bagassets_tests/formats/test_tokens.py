"""Tokens, splits and the form of tables: stable for ever."""

import json
import struct

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from bagassets.formats.groups import Piece, write_rows
from bagassets.formats.json_files import TABLE, rounded, row_blocks, rows_text
from bagassets.formats.nuscenes.join import blank_png
from bagassets.formats.nuscenes.schema import RECORDING_TABLES, SHARED_TABLES, TABLES
from bagassets.formats.nuscenes.table_file import quaternion, read_table, table_bytes
from bagassets.formats.nuscenes.tokens import (
    RecordingTokens,
    category_token,
    filename,
    recording_of,
    sensor_token,
    token,
    visibility_token,
)

pytestmark = pytest.mark.once


class TestTokens:
    def test_they_never_change(self):
        """A change here makes every dataset ever built incompatible with its next build."""
        tokens = RecordingTokens("rig", "drive_1")
        assert (
            tokens.row("sample_data", "CAM_FRONT", 1_700_000_000_123_456_789)
            == "c802d3af6d18501cce0a3c31382a679f"
        )
        assert tokens.track("instance", "/boxes", "7", 5) == "e9cbfb088727b9b5c60cdf343719d8ef"
        assert sensor_token("LIDAR_TOP", "lidar") == "d327cd130744b64578e77865ba729004"
        assert category_token("vehicle.car") == "86d8918b25e0dc388c5e05aa279e11a3"

    @given(
        st.lists(
            st.tuples(
                st.text(max_size=3), st.text(max_size=3), st.sampled_from(["", "A", "B"]), st.integers(0, 3)
            ),
            unique=True,
            max_size=50,
        )
    )
    def test_different_rows_have_different_tokens(self, rows):
        tokens = [
            RecordingTokens(rig, key).row("sample", channel, stamp) for rig, key, channel, stamp in rows
        ]
        assert len(set(tokens)) == len(rows)
        assert all(len(name) == 32 and int(name, 16) >= 0 for name in tokens)

    def test_parts_do_not_run_into_each_other(self):
        assert token("a", "bc") != token("ab", "c")
        assert token("a", 1) != token("a", "1")

    def test_visibility_uses_the_numbers_of_nuscenes(self):
        assert [visibility_token(level) for level in ("v0-40", "v40-60", "v60-80", "v80-100")] == [
            "1",
            "2",
            "3",
            "4",
        ]


class TestTableFiles:
    def test_thirteen_tables(self):
        assert len(TABLES) == 13
        assert {*RECORDING_TABLES, *SHARED_TABLES} == set(TABLES)

    @given(st.lists(st.text(max_size=10), max_size=5))
    def test_joined_tables_are_the_same_as_one_table(self, tmp_path_factory, names):
        folder = tmp_path_factory.mktemp("tables")
        rows = [{"token": name, "name": "],[\n{", "description": ""} for name in names]
        for number in range(3):
            (folder / f"{number}.json").write_bytes(table_bytes("category", rows[number::3]))
        ordered = [row for number in range(3) for row in rows[number::3]]
        texts = (rows_text(folder / f"{number}.json") for number in range(3))
        _, found = write_rows(folder / "category.json", TABLE, [Piece(None, texts)])
        copied = [
            json.loads(line)
            for number in range(3)
            for block in row_blocks(folder / f"{number}.json")
            for line in block
        ]
        assert copied == ordered
        assert [one.number for one in found] == [len(rows)]
        assert (folder / "category.json").read_bytes() == table_bytes("category", ordered)
        assert read_table(folder, "category") == ordered

    def test_a_row_that_lacks_a_column_is_an_error(self):
        with pytest.raises(KeyError):
            table_bytes("category", [{"token": "1", "name": "car"}])

    def test_not_a_number_is_never_written(self):
        with pytest.raises(ValueError, match="JSON"):
            table_bytes("category", [{"token": "1", "name": "car", "description": float("nan")}])

    def test_rounding_leaves_no_negative_zero(self):
        assert json.dumps(rounded([-1e-9, 1.23456789])) == "[0.0, 1.234568]"
        assert json.dumps(quaternion([-1e-12, 1.0])) == "[0.0, 1.0]"


class TestFilenames:
    @given(st.text(min_size=1, max_size=20), st.sampled_from(["CAM_FRONT", "CAM__A"]), st.booleans())
    def test_the_recording_is_found_again(self, key, channel, is_keyframe):
        name = filename(key, channel, 17, "abcdef0123", "pcd.bin", is_keyframe=is_keyframe)
        assert recording_of(name) == key
        assert name.count("/") == 2
        assert name.isascii()

    def test_other_names_belong_to_no_recording(self):
        assert recording_of("maps/blank.png") is None
        assert recording_of("samples/CAM_FRONT/notes.txt") is None


@pytest.mark.parametrize("size", [(1, 1), (64, 64), (300, 400)])
def test_the_blank_map_is_a_real_picture(size):
    data = blank_png(*size)
    picture = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED)
    assert picture.shape == (size[1], size[0])
    assert picture.dtype == np.uint8
    assert not picture.any()
    assert struct.unpack(">II", data[16:24]) == size
