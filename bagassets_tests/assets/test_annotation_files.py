"""Label files beside a recording: every format places the same true boxes; bad ones are named with file and line."""

import json
import shutil

import numpy as np
import pytest
import yaml
from label_files import (
    CLASSES,
    FRAMES,
    SIZES,
    WRITERS,
    box_entries,
    box_json,
    odom_SE3_box,
    stamp_of,
    truth,
)

from bagassets.assets.boxes.table import BoxTable
from bagassets.base.errors import RecipeError
from bagassets.engine.execute import BuildFailure
from bagassets.recipe import load_recipe
from bagassets.recordings.digest import recording_digest, recording_stat
from bagassets.recordings.discover import discover
from bagassets.store.store import Store
from bagassets_tests.recording_build import RecordingBuild
from bagassets_tests.small_drive import RECIPE, START_NS, write_drive

pytestmark = pytest.mark.once

ALL = {"inventory", "calibration", "ego_poses", "annotations", "frames", "sweeps", "nuscenes_tables"}
BOXES = {"inventory", "calibration", "ego_poses", "annotations"}
COUNT = FRAMES * len(SIZES)


@pytest.fixture(scope="module")
def built(tmp_path_factory):
    """A project without labels, whose store has all the rest."""
    folder = tmp_path_factory.mktemp("built")
    write_drive(folder / "bags" / "a.mcap", "mcap", duration_s=2.2)
    build(load(folder / "bags"), ALL)
    return folder


@pytest.fixture
def bags(tmp_path, built):
    shutil.copytree(built, tmp_path, dirs_exist_ok=True)
    return tmp_path / "bags"


def load(bags, *sources):
    data = yaml.safe_load(RECIPE.format(name="test", root="bags"))
    data["rigs"][0]["annotation_files"] = list(sources)
    (bags.parent / "recipe.yaml").write_text(yaml.safe_dump(data))
    return load_recipe(bags.parent / "recipe.yaml")


def build(recipe, wanted=BOXES, key="a.mcap", **options):
    recording = discover(recipe.bags).recordings[key]
    digest = recording_digest(recording).digest
    store = Store(recipe.store_path)
    made = RecordingBuild(recipe, store, recording, digest, recording_stat(recording), **options)
    return {result.asset: result for result in made.build(wanted)}


def annotate(bags, *sources):
    """Return the table and the counts of the only source."""
    artifact = build(load(bags, *sources))["annotations"].artifact
    counts = artifact.read_json("annotations.json")["counts"]
    return BoxTable.from_arrow(artifact.read_table("annotations.parquet")), counts[sources[0]["path"]]


def refusal(bags, *sources):
    with pytest.raises(BuildFailure) as caught:
        build(load(bags, *sources))
    (error,) = caught.value.errors.values()
    return str(error)


class TestFormats:
    @pytest.mark.parametrize("name", WRITERS)
    def test_every_format_gives_the_true_boxes(self, bags, name):
        source = WRITERS[name](bags) | {"categories": {"Car": "vehicle.car"}}
        table, counts = annotate(bags, source)
        assert len(table) == COUNT
        assert counts["boxes"]["written"] == counts["boxes"]["read"] == COUNT
        assert counts["ignored"] == {"kitti_tracking": 1, "nuscenes": 1}.get(name, 0)
        assert set(table.categories) == {"vehicle.car", "Pedestrian"}
        tracks = {}
        for row in range(len(table)):
            true_track = next(track for track, size in SIZES.items() if size == tuple(table.sizes_m[row]))
            tracks.setdefault(true_track, set()).add(table.tracks[row])
            stamp = int(table.stamps_ns[row])
            pose = odom_SE3_box(true_track, stamp)
            np.testing.assert_allclose(table.centers_m[row], pose.translation, atol=2e-5)
            assert abs(np.dot(table.rotations[row], pose.rotation)) == pytest.approx(1.0, abs=1e-9)
        numbers = {stamp_of(frame) // 1000 for frame in range(FRAMES)}
        assert {int(stamp) // 1000 for stamp in table.stamps_ns} == numbers
        if name != "kitti_objects":  # single frames know no tracks
            assert all(len(names) == 1 for names in tracks.values())

    def test_attributes_are_mapped_by_name_and_given_by_category(self, bags):
        entries = [{**entry, "attributes": ["a", "b", "c"]} for entry in box_entries()]
        (bags / "x.json").write_text(box_json(entries))
        table, _ = annotate(
            bags,
            {
                "format": "boxes", "path": "x.json", "attribute_names": {"a": "vehicle.moving", "b": ""},
                "attributes": {"Car": ["seen"]},
            },
        )  # fmt: skip
        by_category = dict(zip(table.categories, map(tuple, table.attributes), strict=True))
        assert by_category == {"Car": ("vehicle.moving", "c", "seen"), "Pedestrian": ("vehicle.moving", "c")}

    def test_nuscenes_attributes_come_by_name(self, bags):
        table, _ = annotate(bags, WRITERS["nuscenes"](bags))
        assert {tuple(a) for c, a in zip(table.categories, table.attributes, strict=True) if c == "Car"} == {
            ("vehicle.moving",)
        }

    def test_euler_angles_of_sustechpoints_turn_about_x_last(self, bags):
        folder = bags / "label"
        folder.mkdir()
        psr = {
            "position": {"x": 9.0, "y": 0.0, "z": 0.0},
            "scale": {"x": 4.0, "y": 2.0, "z": 1.0},
            "rotation": {"x": 0.1, "y": 0.2, "z": 0.3},
        }
        (folder / "2.json").write_text(json.dumps([{"obj_id": "1", "obj_type": "Car", "psr": psr}]))
        table, _ = annotate(
            bags,
            {
                "format": "sustechpoints", "path": "label", "frame": "lidar",
                "times": {"by": "topic", "topic": "/points"},
            },
        )  # fmt: skip

        def turn(axis, angle):
            c, s = np.cos(angle), np.sin(angle)
            i, j = [(1, 2), (2, 0), (0, 1)][axis]
            matrix = np.eye(3)
            matrix[i, i], matrix[i, j], matrix[j, i], matrix[j, j] = c, -s, s, c
            return matrix

        w, x, y, z = table.rotations[0]
        front = [1 - 2 * (y * y + z * z), 2 * (x * y + w * z), 2 * (x * z - w * y)]
        expected = turn(0, 0.1) @ turn(1, 0.2) @ turn(2, 0.3) @ [1.0, 0, 0]
        np.testing.assert_allclose(front, expected, atol=1e-12)

    def test_a_folder_may_hold_several_box_files(self, bags):
        (bags / "labels").mkdir()
        entries = box_entries()
        (bags / "labels" / "1.json").write_text(box_json(entries[:10]))
        (bags / "labels" / "2.json").write_text(box_json(entries[10:]))
        (bags / "labels" / "notes.txt").write_text("nothing to do with it")
        table, counts = annotate(bags, {"format": "boxes", "path": "labels"})
        assert len(table) == COUNT
        assert counts["files"]["read"] == 2

    def test_our_own_table_can_be_read_back(self, bags):
        first, _ = annotate(bags, WRITERS["boxes.json"](bags))
        artifact = build(load(bags, {"format": "boxes", "path": "{stem}.boxes.json"}))["annotations"].artifact
        shutil.copy(artifact.path("annotations.parquet"), bags / "mine.parquet")
        again, _ = annotate(bags, {"format": "boxes", "path": "mine.parquet", "frame": "@dataset"})
        np.testing.assert_array_equal(first.centers_m, again.centers_m)
        assert first.tracks == again.tracks

    @pytest.mark.parametrize("clock", ["header", "log"])
    def test_frames_of_a_channel_with_its_own_clock_have_the_times_of_its_messages(self, bags, clock):
        """Else labels would be beside the clouds that they were drawn into."""
        labels = WRITERS["sustechpoints"](bags)
        data = yaml.safe_load(RECIPE.format(name="test", root="bags"))
        data |= {"clock": "header" if clock == "log" else "log"}
        data["rigs"][0]["annotation_files"] = [labels | {"outside": "keep"}]
        data["rigs"][0]["channels"]["LIDAR_TOP"] |= {"clock": clock}
        (bags.parent / "recipe.yaml").write_text(yaml.safe_dump(data))
        recipe = load_recipe(bags.parent / "recipe.yaml")
        made = build(recipe, {*BOXES, "sweeps"})
        clouds = Store(recipe.store_path).artifact(made["sweeps"].channels["LIDAR_TOP"])
        table = BoxTable.from_arrow(made["annotations"].artifact.read_table("annotations.parquet"))
        assert {*table.stamps_ns.tolist()} <= {*clouds.read_table("index.parquet")["stamp_ns"].to_pylist()}

    def test_times_may_be_shifted(self, bags):
        source = WRITERS["kitti_objects"](bags) | {"offset_s": 0.05}
        table, _ = annotate(bags, source)
        assert int(table.stamps_ns[0]) == stamp_of(0) + 50_000_000


class TestStaleness:
    def ran(self, recipe, **options):
        return {name for name, made in build(recipe, ALL, **options).items() if not made.cached}

    def test_editing_a_label_file_reruns_annotations_and_tables_only(self, bags):
        recipe = load(bags, WRITERS["boxes.json"](bags))
        assert self.ran(recipe) == {"annotations", "nuscenes_tables"}
        assert self.ran(recipe) == set()
        entries = box_entries()
        entries[0]["center"][0] += 0.5
        (bags / "a.boxes.json").write_text(box_json(entries))
        assert self.ran(recipe) == {"annotations", "nuscenes_tables"}
        (bags / "a.boxes.json").write_text(box_json())
        assert self.ran(recipe) == set()

    def test_one_file_of_a_folder_is_enough_and_so_is_a_new_or_removed_one(self, bags):
        recipe = load(bags, WRITERS["sustechpoints"](bags))
        assert self.ran(recipe) == {"annotations", "nuscenes_tables"}
        folder = bags / "a" / "label"
        (folder / "000003.json").write_text("[]")
        assert self.ran(recipe) == {"annotations", "nuscenes_tables"}
        (folder / "000004.json").unlink()
        assert self.ran(recipe) == {"annotations", "nuscenes_tables"}
        (folder / "readme.md").write_text("not a label")
        assert self.ran(recipe) == set()

    def test_a_file_of_times_is_an_input_too(self, bags):
        recipe = load(bags, WRITERS["kitti_tracking"](bags))
        assert self.ran(recipe) == {"annotations", "nuscenes_tables"}
        path = bags / "timestamps.txt"
        path.write_text(path.read_text() + f"{stamp_of(FRAMES)}\n")
        # The boxes are the same: their tables need not be made again.
        assert self.ran(recipe) == {"annotations"}

    def test_a_renamed_recording_with_its_labels_is_a_hit(self, bags):
        recipe = load(bags, WRITERS["boxes.json"](bags))
        assert self.ran(recipe) == {"annotations", "nuscenes_tables"}
        (bags / "a.mcap").rename(bags / "b.mcap")
        (bags / "a.boxes.json").rename(bags / "b.boxes.json")
        assert self.ran(recipe, key="b.mcap") == {"nuscenes_tables"}  # tokens name the recording

    def test_a_dry_walk_sees_the_edit_and_runs_nothing(self, bags):
        recipe = load(bags, WRITERS["boxes.json"](bags))
        build(recipe, ALL)
        assert self.ran(recipe, dry=True) == set()
        (bags / "a.boxes.json").write_text(box_json([]))
        with pytest.raises(BuildFailure) as caught:
            build(recipe, ALL, dry=True)
        assert caught.value.errors.keys() == {"annotations"}

    def test_a_recording_without_labels_reads_nothing(self, bags):
        recipe = load(bags, {"format": "boxes", "path": "{stem}.boxes.json"})
        artifact = build(recipe)["annotations"].artifact
        assert artifact.read_json("annotations.json")["absent"] == ["{stem}.boxes.json"]
        assert artifact.read_table("annotations.parquet").num_rows == 0


BOX_FILE = {"format": "boxes", "path": "x.json"}


def spoil(bags, number, **fields):
    """Write a box file whose entry `number` is spoilt; entries begin on line 3."""
    entries = box_entries()
    entries[number] = {
        name: value for name, value in {**entries[number], **fields}.items() if value is not ...
    }
    (bags / "x.json").write_text(box_json(entries))


class TestBadBoxes:
    @pytest.mark.parametrize(
        ("fields", "reason"),
        [
            ({"size": [1.0, 0.0, 1.0]}, "its size is not positive"),
            ({"size": [1.0, -2.0, 1.0]}, "its size is not positive"),
            ({"size": [1.0, 2.0]}, "its size is no list of 3 numbers"),
            ({"size": [1.0, 2.0, "3"]}, "its size is no list of 3 numbers"),
            ({"center": [0.0, float("nan"), 0.0]}, "its position or rotation is not finite"),
            ({"rotation": [0.0, 0.0, 0.0, 0.0]}, "its rotation is no unit quaternion"),
            ({"rotation": ..., "yaw": float("inf")}, "its position or rotation is not finite"),
            ({"yaw": 0.5}, "it has both rotation and yaw"),
            ({"category": ...}, "it has no category"),
            ({"category": 3}, "its category is no text"),
            ({"stamp_ns": 1.7e18}, "its stamp_ns is no whole number"),
            ({"stamp_ns": True}, "its stamp_ns is no whole number"),
            ({"stamp_ns": START_NS - 2_000_000_000}, "its time is outside the recording"),
            ({"stamp_ns": START_NS + 9_000_000_000}, "its time is outside the recording"),
            ({"track_id": True}, "its track_id is neither text nor a whole number"),
            ({"attributes": "moving"}, "its attributes are no list of texts"),
            ({"score": "high"}, "its score is no number"),
            ({"colour": "red"}, "it has the unknown field colour"),
        ],
    )
    def test_are_counted_with_file_and_line_or_refused_with_path_and_line(self, bags, fields, reason):
        spoil(bags, 6, **fields)
        table, counts = annotate(bags, BOX_FILE)
        assert len(table) == COUNT - 1
        assert counts["boxes"]["lost"] == {reason: 1}
        assert counts["boxes"]["first"] == {reason: "x.json:9"}
        assert counts["boxes"]["read"] == COUNT
        sentence = refusal(bags, BOX_FILE | {"bad_boxes": "refuse", "outside": "refuse"})
        assert sentence.startswith(f"{bags / 'x.json'}:9: a box cannot be used ({reason})")

    def test_two_boxes_of_a_track_at_one_time(self, bags):
        entries = box_entries()
        spoil(bags, 7, track_id=entries[6]["track_id"])
        table, counts = annotate(bags, BOX_FILE)
        assert counts["boxes"]["first"] == {"second box of one track at one time": "x.json:10"}
        assert len(table) == COUNT - 1
        assert f"{bags / 'x.json'}:10" in refusal(bags, BOX_FILE | {"bad_boxes": "refuse"})

    def test_a_box_outside_may_be_kept_and_is_counted(self, bags):
        spoil(bags, 6, stamp_ns=START_NS + 9_000_000_000)
        table, counts = annotate(bags, BOX_FILE | {"outside": "keep"})
        assert len(table) == COUNT
        assert counts["boxes"]["kept"] == {"its time is outside the recording": 1}

    def test_an_unknown_class_is_kept_left_out_or_refused(self, bags):
        spoil(bags, 6, category="dragon")
        mapped = BOX_FILE | {"categories": {"Car": "vehicle.car", "Pedestrian": "human.pedestrian.adult"}}
        table, counts = annotate(bags, mapped)
        assert "dragon" in table.categories
        assert counts["boxes"]["kept"] == {"its class is not in `categories`": 1}
        table, counts = annotate(bags, mapped | {"unmapped": "count"})
        assert "dragon" not in table.categories
        assert counts["boxes"]["first"] == {"its class is not in `categories`": "x.json:9"}
        sentence = refusal(bags, mapped | {"unmapped": "refuse"})
        assert sentence.startswith(f"{bags / 'x.json'}:9: ")
        _, counts = annotate(bags, BOX_FILE)  # without a mapping every class is as good as another
        assert counts["boxes"]["kept"] == {}

    def test_no_ego_pose(self, bags):
        entries = [{**entry, "frame": "lidar"} for entry in box_entries("lidar")]
        entries[0]["stamp_ns"] = START_NS - 500_000_000
        (bags / "x.json").write_text(box_json(entries))
        _, counts = annotate(bags, BOX_FILE)
        assert counts["boxes"]["first"] == {"no ego pose at its time": "x.json:3"}

    def test_boxes_in_an_unknown_frame_fail_with_a_way_out(self, bags):
        (bags / "x.json").write_text(box_json(frame="mars"))
        assert "frame mars, but the known frames are" in refusal(bags, BOX_FILE)

    def test_kitti_lines(self, bags):
        source = WRITERS["kitti_tracking"](bags)
        lines = (bags / "a.txt").read_text().splitlines()
        lines[4] = lines[4] + " 1 2 3"
        lines[5] = lines[5].replace("Car 0", "Car nil")
        lines[6] = "x" + lines[6]
        lines[7] = "99" + lines[7][1:]
        lines[8] = " ".join([*lines[8].split()[:-1], "nan"])
        (bags / "a.txt").write_text("\n".join(lines))
        _, counts = annotate(bags, source)
        assert counts["boxes"]["first"] == {
            "it has 20 columns instead of 17 or 18": "{stem}.txt:5",
            "its frame or track is no whole number": "{stem}.txt:7",
            "its frame has no time": "{stem}.txt:8",
            "its position or rotation is not finite": "{stem}.txt:9",
        }
        lines[10] = lines[10].replace(lines[10].split()[-1], "2,5")
        (bags / "a.txt").write_text("\n".join(lines))
        assert annotate(bags, source)[1]["boxes"]["first"]["a number cannot be read"] == "{stem}.txt:11"

    def test_tracklets(self, bags):
        source = WRITERS["kitti_tracklets"](bags)
        path = bags / "tracklet_labels.xml"
        text = path.read_text()
        path.write_text(
            text.replace("<tx>", "<ux>", 1).replace("</tx>", "</ux>", 1).replace("<h>1.8</h>", "<h>tall</h>")
        )
        table, counts = annotate(bags, source)
        assert len(table) == FRAMES - 1
        assert counts["boxes"]["lost"] == {
            "it has no tx": 1,
            "size or first frame of its tracklet is no number": FRAMES,
        }
        assert counts["boxes"]["first"]["it has no tx"] == "tracklet_labels.xml:8"

    def test_rows_of_nuscenes_that_lead_nowhere(self, bags):
        source = WRITERS["nuscenes"](bags)
        path = bags / "v1.0-old" / "sample_annotation.json"
        rows = json.loads(path.read_text())
        for number, column in enumerate(("sample_token", "instance_token")):
            rows[number][column] = "nowhere"
        rows[2]["attribute_tokens"] = ["nowhere"]
        rows[3]["size"] = None
        path.write_text("[\n" + ",\n".join(json.dumps(row) for row in rows) + "\n]")
        _, counts = annotate(bags, source)
        assert counts["boxes"]["first"] == {
            "its sample_token is in no row of sample.json": "sample_annotation.json:2",
            "its instance_token is in no row of instance.json": "sample_annotation.json:3",
            "an attribute token is in no row of attribute.json": "sample_annotation.json:4",
            "its size is no list of 3 numbers": "sample_annotation.json:5",
        }

    def test_entries_of_sustechpoints(self, bags):
        source = WRITERS["sustechpoints"](bags)
        path = bags / "a" / "label" / "000002.json"
        content = json.loads(path.read_text())
        content[0]["psr"]["scale"].pop("x")
        content[1].pop("obj_type")
        path.write_text(json.dumps(content, indent=None).replace('}, {"obj_id"', '},\n{"obj_id"'))
        _, counts = annotate(bags, source)
        assert counts["boxes"]["first"] == {
            "its scale is no x, y, z": "000002.json:1",
            "it has no obj_type": "000002.json:2",
        }


class TestBadFiles:
    @pytest.mark.parametrize(
        ("text", "words"),
        [
            (
                '{"format": "bagassets-boxes",\n "version": 1,\n "boxes": [\n {"stamp_ns": }\n]}',
                "x.json:4: the file is no JSON",
            ),
            ("[]", "x.json:1: the file is no box file"),
            ('{"format": "bagassets-boxes", "version": 2, "boxes": []}', "x.json:1: the file has version 2"),
            ('{"format": "bagassets-boxes", "version": 1}', "x.json:1: the file has no list `boxes`"),
            (
                '{"format": "bagassets-boxes", "version": 1, "bxes": []}',
                "x.json:1: the file has the unknown field bxes",
            ),
            (b'{"format": "bagassets-boxes",\n"a\xff"', "x.json:2: the file is not UTF-8 text"),
        ],
    )
    def test_fail_the_recording_or_are_left_out_and_counted(self, bags, text, words):
        (bags / "x.json").write_bytes(text if isinstance(text, bytes) else text.encode())
        sentence = refusal(bags, BOX_FILE)
        assert sentence.startswith(f"{bags}/{words}")
        assert "bad_files: count" in sentence
        table, counts = annotate(bags, BOX_FILE | {"bad_files": "count"})
        assert len(table) == 0
        assert counts["files"]["read"] == 1
        assert sum(counts["files"]["lost"].values()) == 1
        (place,) = counts["files"]["first"].values()
        assert words.startswith(place)

    @pytest.mark.parametrize(
        ("name", "path", "damage", "words"),
        [
            ("kitti_tracklets", "tracklet_labels.xml", lambda t: t[:900], "the file is no XML"),
            ("kitti_tracklets", "tracklet_labels.xml", lambda _: "<a/>", "has no element"),
            (
                "kitti_tracklets", "tracklet_labels.xml",
                lambda t: t.replace("<!DOCTYPE boost_serialization>", '<!DOCTYPE b [<!ENTITY a "b">]>'),
                "tracklet_labels.xml:2: the file declares XML entities",
            ),
            ("sustechpoints", "a/label/000001.json", lambda _: "{}", "000001.json:1: the file is no list of objects"),
            ("boxes.parquet", "labels/a.parquet", lambda _: "PAR1", "the file is no Parquet file"),
            ("nuscenes", "v1.0-old/sample.json", lambda _: "{}", "sample.json:1: the file is no table"),
            ("kitti_tracking", "timestamps.txt", lambda t: "yesterday\n" + t, "timestamps.txt:1: 'yesterday' is neither"),
        ],
    )  # fmt: skip
    def test_of_each_format_are_named(self, bags, name, path, damage, words):
        source = WRITERS[name](bags)
        file = bags / path
        file.write_text(damage(file.read_text(errors="replace")))
        sentence = refusal(bags, source)
        assert str(file) in sentence
        assert words in sentence

    def test_labels_may_be_insisted_on(self, bags):
        sentence = refusal(bags, BOX_FILE | {"missing": "refuse"})
        assert sentence.startswith(f"{bags / 'x.json'}: there are no labels of the format boxes")

    def test_what_gives_the_times_must_be_there(self, bags):
        source = WRITERS["kitti_tracking"](bags)
        (bags / "timestamps.txt").unlink()
        assert "there is no file of times timestamps.txt" in refusal(bags, source)
        other = source | {"times": {"by": "topic", "topic": "/nowhere"}}
        assert "no messages on /nowhere" in refusal(bags, other)


class TestRecipe:
    @pytest.mark.parametrize(
        ("sources", "words"),
        [
            ([{"format": "boxes", "path": "{bag}.json"}], "`{bag}` is not a placeholder"),
            ([{"format": "boxes", "path": " "}], "must not be empty"),
            ([BOX_FILE, BOX_FILE], "x.json is listed twice"),
            ([{"format": "kitti", "path": "a"}], "must be boxes, sustechpoints, kitti_tracklets"),
            ([{"format": "sustechpoints", "path": "a"}], "times: this field is required"),
            ([{"format": "kitti_tracklets", "path": "a", "times": {"by": "name"}}], "must be topic or file"),
        ],
    )
    def test_what_cannot_be_meant_is_refused(self, bags, sources, words):
        with pytest.raises(RecipeError) as caught:
            load(bags, *sources)
        assert words in str(caught.value)


def test_the_truth_has_all_classes():
    assert {track for _, _, track, _ in truth()} == set(CLASSES)
