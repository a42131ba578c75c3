"""Each action is keyed by what it truly reads: the table of what runs after which change."""

import json
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import pytest

from bagassets.assets import calibration, frames, signals, sweeps
from bagassets.assets.asset import Asset
from bagassets.engine.execute import BuildFailure
from bagassets.engine.recording_assets import RecordingAssets
from bagassets.formats.catalogue import known_assets
from bagassets.recipe import load_recipe
from bagassets.recordings.digest import recording_digest, recording_stat
from bagassets.recordings.discover import discover
from bagassets.store.store import Store
from bagassets_tests import keyed_drive as drive
from bagassets_tests.confined import confined
from bagassets_tests.recording_build import UPSTREAM, RecordingBuild
from bagassets_tests.reindexed_bag import reindexed as reindexed_bag

pytestmark = pytest.mark.once

KEY = "a.bag"


@pytest.fixture(scope="module")
def project(tmp_path_factory):
    folder = tmp_path_factory.mktemp("keys")
    (folder / "recipe.yaml").write_text(drive.RECIPE)
    drive.write_lens(folder)
    drive.write(folder / "bags" / KEY, drive.drive())
    ran = build(folder / "recipe.yaml", KEY)
    channels = {"frames:CAM_FRONT", "frames:CAM_BACK", "sweeps:LIDAR_TOP", "signals:motion"}
    assert ran == channels | UPSTREAM.keys() - {"frames", "sweeps", "signals"}, (
        "everything runs the first time"
    )
    return folder


def build(recipe_file, key, **options):
    """Build one recording; return the actions that ran, as step or step:channel."""
    recipe = load_recipe(recipe_file)
    store = Store(recipe.state / "store")
    before = actions(store)
    recording = discover(recipe.bags).recordings[key]
    digest = recording_digest(recording).digest
    made = RecordingBuild(recipe, store, recording, digest, recording_stat(recording), **options)
    assert {result.asset for result in made.build()} == set(UPSTREAM)
    ran = [action for digest, action in actions(store).items() if digest not in before]
    # The index of an asset's channels is bookkeeping: it reads nothing but which channels there are.
    # The track is the map's, which is of no single recording; the pictures have it made ahead.
    return {label(a) for a in ran if not a["step"].endswith("_index") and a["step"] != "track"}


def actions(store):
    return {path.stem: json.loads(path.read_text())["action"] for path in store.root.glob("actions/*/*.json")}


def label(action):
    channel = action["params"].get("channel") or action["params"].get("signal")
    return f"{action['step']}:{channel}" if channel else action["step"]


def message(topic, change, **options) -> Callable[[Path], str]:
    """Rewrite the recording with one message changed."""

    def make(folder):
        drive.write(folder / "bags" / KEY, drive.changed(drive.drive(), topic, change, **options))
        return KEY

    return make


def recipe(old, new) -> Callable[[Path], str]:
    """Edit the recipe."""

    def make(folder):
        text = (folder / "recipe.yaml").read_text()
        assert old in text
        (folder / "recipe.yaml").write_text(text.replace(old, new))
        return KEY

    return make


def without_the_back(folder):
    path = folder / "recipe.yaml"
    path.write_text("".join(line for line in path.read_text().splitlines(True) if "CAM_BACK" not in line))
    return KEY


def calibrated_anew(folder):
    drive.write_lens(folder, fx=31.0)
    return KEY


def calibration_file_touched(folder):
    drive.write_lens(folder)
    return KEY


def renamed(folder):
    (folder / "bags" / KEY).rename(folder / "bags" / "b.bag")
    return "b.bag"


def duplicated(folder):
    (folder / "bags" / "copy.bag").write_bytes((folder / "bags" / KEY).read_bytes())
    return "copy.bag"


def compressed(folder):
    drive.write(folder / "bags" / KEY, drive.drive(), compression="BZ2")
    return KEY


def reindexed(folder):
    path = folder / "bags" / KEY
    before = path.read_bytes()
    path.write_bytes(reindexed_bag(before))
    assert path.read_bytes() != before
    return KEY


def touched(folder):
    (folder / "bags" / KEY).touch()
    return KEY


@dataclass(frozen=True)
class Row:
    """A change, and exactly what runs after it."""

    name: str
    change: Callable[[Path], str]
    runs: frozenset[str]


def row(name, change, *runs):
    return pytest.param(Row(name, change, frozenset(runs)), id=name)


# This table is printed in docs/how-it-decides.md. Poses read the transforms that join the odometry's frame
# to the vehicle's; a box may be in the frame of any sensor.
TABLE = [
    row("only touched", touched),
    row("metadata only", message(drive.NOTES, drive.another_note), "inventory"),
    row("one camera's messages", message("/back/image_raw", drive.one_pixel),
        "inventory", "frames:CAM_BACK", "nuscenes_tables", "vision_sequences", "preview"),
    row("odometry", message("/odom", drive.one_metre, at=30),
        "inventory", "ego_poses", "annotations", "nuscenes_tables", "vision_sequences", "preview"),
    row("one annotation", message("/boxes", drive.another_box),
        "inventory", "annotations", "nuscenes_tables", "preview"),
    row("tf_static", message("/tf_static", drive.another_mount),
        "inventory", "calibration", "ego_poses", "annotations", "nuscenes_tables", "vision_sequences", "preview"),
    row("JPEG quality", recipe("topic: /back/image_raw", "topic: /back/image_raw, quality: 40"),
        "frames:CAM_BACK", "nuscenes_tables", "vision_sequences", "preview"),
    row("one camera's calibration file", calibrated_anew,
        "calibration", "frames:CAM_BACK", "nuscenes_tables", "vision_sequences", "preview"),
    row("that file only touched", calibration_file_touched),
    row("keyframe rate", recipe("vision:", "scenes: {keyframe_hz: 4}\nvision:"), "nuscenes_tables"),
    row("scene length", recipe("vision:", "scenes: {length_s: 1.5}\nvision:"), "nuscenes_tables"),
    row("one channel added",
        recipe("      LIDAR_TOP:", "      CAM_LEFT: {modality: camera, topic: /cam/image_raw}\n      LIDAR_TOP:"),
        "calibration", "frames:CAM_LEFT", "nuscenes_tables", "vision_sequences", "preview"),
    row("one channel removed", without_the_back,
        "calibration", "annotations", "nuscenes_tables", "vision_sequences", "preview"),
    row("file renamed", renamed, "nuscenes_tables", "vision_sequences"),
    row("file duplicated", duplicated, "nuscenes_tables", "vision_sequences"),
    row("bag re-compressed", compressed, "inventory"),
    row("bag re-indexed", reindexed, "inventory"),
]  # fmt: skip


# An asset that no row names is not in the table yet.
COLUMNS = [name for name in UPSTREAM if name == "sweeps" or any(
    name == action.split(":")[0] for param in TABLE for action in param.values[0].runs)]  # fmt: skip


def ran_of_table(recipe_file, key):
    return {action for action in build(recipe_file, key) if action.split(":")[0] in COLUMNS}


@pytest.fixture
def copy(project, tmp_path):
    """A copy of the project whose store knows the unchanged recording."""
    import shutil

    shutil.copytree(project, tmp_path / "project")
    return tmp_path / "project"


@pytest.mark.parametrize("row", TABLE)
def test_exactly_what_reads_the_change_runs(copy, row):
    key = row.change(copy)
    assert ran_of_table(copy / "recipe.yaml", key) == row.runs
    assert build(copy / "recipe.yaml", key) == frozenset(), "and nothing the second time"


def test_a_new_version_of_a_step_runs_that_step_and_stops_where_bytes_are_the_same(copy, monkeypatch):
    mine = [
        replace(asset, version=asset.version + 1) if asset.name == "frames" else asset
        for asset in known_assets()
    ]
    monkeypatch.setattr(
        "bagassets_tests.recording_build.recording_assets", partial(RecordingAssets, known=mine)
    )
    assert ran_of_table(copy / "recipe.yaml", KEY) == {"frames:CAM_FRONT", "frames:CAM_BACK"}


def test_a_metadata_change_opens_no_image_or_cloud(copy, monkeypatch):
    def refuse(*_, **__):
        raise AssertionError("nothing may be decoded")

    monkeypatch.setattr("bagassets.assets.frames.FrameExtractor", refuse)
    monkeypatch.setattr("bagassets.assets.sweeps.SweepExtractor", refuse)
    key = message(drive.NOTES, drive.another_note)(copy)
    assert ran_of_table(copy / "recipe.yaml", key) == {"inventory"}


def markdown():
    """Return the table as docs/how-it-decides.md shows it."""
    lines = [f"| after | {' | '.join(COLUMNS)} |", "|---|" + ":-:|" * len(COLUMNS)]
    rows = [param.values[0] for param in TABLE]
    cameras = {"frames:CAM_FRONT", "frames:CAM_BACK"}
    for row in [*rows, Row("version of the step frames", renamed, frozenset(cameras))]:
        cells = []
        for column in COLUMNS:
            ran = {name for name in row.runs if name.split(":")[0] == column}
            cells.append(
                "" if not ran else "both" if ran == cameras else "one" if column == "frames" else "runs"
            )
        lines.append(f"| {row.name} | {' | '.join(cells)} |")
    return "\n".join(lines)


def test_the_table_in_the_docs_is_this_one():
    page = (Path(__file__).parents[2] / "docs" / "how-it-decides.md").read_text("utf-8")
    assert page.partition("<!-- table -->\n")[2].partition("\n<!-- end of table -->")[0] == markdown()


# --- undeclared access --------------------------------------------------------------------


def test_a_step_cannot_read_a_topic_that_it_did_not_declare(copy, monkeypatch):
    class Curious(frames.FrameExtractor):
        def finish(self):
            # What another channel reads in the same pass is none of its business, either.
            for topic in {"/odom", "/cam/image_raw", "/back/image_raw"} - {*self.topics}:
                with pytest.raises(KeyError, match=topic):
                    list(self.curious.messages([topic]))
            asked.append(self.topics)
            return super().finish()

        def __init__(self, use, recording, *rest):
            self.curious = recording
            super().__init__(use, recording, *rest)

    asked = []
    monkeypatch.setattr("bagassets.assets.frames.FrameExtractor", Curious)
    recipe("/image_raw", "/image_raw, quality: 41")(copy)
    build(copy / "recipe.yaml", KEY)
    assert sorted(asked) == [("/back/image_raw",), ("/cam/image_raw",)]


def test_a_channel_that_cannot_be_planned_costs_itself_alone(copy):
    recipe("/cam/image_raw", "/cam/image_raw, quality: 41")(copy)
    recipe("topic: /back/image_raw", "topic: /odom, undistort: false, extrinsics: {}")(copy)
    with pytest.raises(BuildFailure) as failure:
        build(copy / "recipe.yaml", KEY)
    assert failure.value.errors.keys() == {"frames"}
    assert str(failure.value.errors["frames"]).startswith("CAM_BACK (/odom): carries nav_msgs/msg/Odometry")
    recipe("topic: /odom, undistort: false, extrinsics: {}", "topic: /back/image_raw")(copy)
    ran = build(copy / "recipe.yaml", KEY)
    assert "nuscenes_tables" in ran
    assert not {name for name in ran if name.startswith("frames")}, "the images of CAM_FRONT were made before"


def test_a_step_is_handed_parameters_and_not_the_recipe(copy, monkeypatch):
    """Whatever a step asks of its parameters is in the key; what is not in the key is not there."""
    seen = {}

    def note(name, *handed):
        seen[name] = [type(value).__module__ for value in handed]

    original_run = Asset.run

    def run(asset, use, inputs, out):
        note(asset.name, use, use.params, *vars(inputs).values(), out)
        return original_run(asset, use, inputs, out)

    monkeypatch.setattr(Asset, "run", run)
    for name, extractor in (
        ("frames", frames.FrameExtractor),
        ("sweeps", sweeps.SweepExtractor),
        ("signals", signals.SignalExtractor),
    ):

        def init(self, *handed, _name=name, _original=extractor.__init__):
            note(_name, *handed)
            _original(self, *handed)

        monkeypatch.setattr(extractor, "__init__", init)
    store = Store(load_recipe(copy / "recipe.yaml").state / "store")
    import shutil

    shutil.rmtree(store.root)
    build(copy / "recipe.yaml", KEY)
    assert set(seen) == {"track", *UPSTREAM}
    for name, handed in seen.items():
        assert not [m for m in handed if m.startswith("bagassets.recipe")], name


def remake(folder, asset):
    """Make an asset again, whatever is on record of it; return its digest, and the one it had before."""
    recipe = load_recipe(folder / "recipe.yaml")
    store = Store(recipe.state / "store")
    recording = discover(recipe.bags).recordings[KEY]
    digest, stat = recording_digest(recording).digest, recording_stat(recording)
    made = {r.asset: r for r in RecordingBuild(recipe, store, recording, digest, stat, dry=True).build()}
    for action_digest, action in actions(store).items():
        if label(action).split(":")[0].removesuffix("_index") == asset:
            store.forget(action_digest)
    upstream = {
        name: made[name].artifact for name in {*UPSTREAM[asset], "inventory"}
    }  # which says whether it takes part
    again = RecordingBuild(recipe, store, recording, digest, stat, upstream)
    with confined(
        made["inventory"].artifact.digest, recording.path, [folder / "recipe.yaml", folder / "back.yaml"]
    ):
        (result,) = again.build([asset])
    assert not result.cached
    return result.artifact.digest, made[asset].artifact.digest


@pytest.mark.parametrize("asset", [asset for asset in UPSTREAM if asset != "inventory"])
def test_a_step_opens_only_what_it_declares(copy, asset):
    """It makes the same bytes where there is no other file."""
    now, before = remake(copy, asset)
    assert now == before


class Curious:
    """Has the step `calibration` read the poses, which it does not declare, and add what it saw to its summary."""

    def __init__(self, monkeypatch, look):
        self.poses = None
        original = calibration.make_calibration

        def make(*args, **kwargs):
            return original(*args, **kwargs) | {"seen": look(self.poses) if self.poses else None}

        monkeypatch.setattr(calibration, "make_calibration", make)

    def build(self, folder):
        """Build with what it wants to see in sight."""
        (self.poses,) = folder.rglob("ego_poses.parquet")
        for path in folder.rglob("actions/*/*.json"):
            if json.loads(path.read_text())["action"]["step"] == "calibration":
                path.unlink()
        assert build(folder / "recipe.yaml", KEY) == {"calibration"}


def rows(path):
    import pyarrow.parquet

    return pyarrow.parquet.read_metadata(path).num_rows


def rows_if_there(path):
    return rows(path) if path.exists() else None


def test_a_read_by_pyarrow_that_was_not_declared_is_seen(copy, monkeypatch):
    Curious(monkeypatch, rows).build(copy)
    with pytest.raises(BuildFailure, match=r"ego_poses\.parquet"):
        remake(copy, "calibration")


def test_a_read_that_was_not_declared_is_seen_even_if_the_step_does_without(copy, monkeypatch):
    Curious(monkeypatch, rows_if_there).build(copy)
    now, before = remake(copy, "calibration")
    assert now != before
