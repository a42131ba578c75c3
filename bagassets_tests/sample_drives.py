"""A sample drive in three formats, built into a dataset: what tests against truth share."""

import json
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from bagassets.formats.assembly import assemble
from bagassets.formats.format import Part
from bagassets.formats.nuscenes.format import NUSCENES
from bagassets.geometry.se3 import SE3
from bagassets.recipe import load_recipe
from bagassets.recordings.digest import recording_digest, recording_stat
from bagassets.recordings.discover import discover
from bagassets.sample.drive import Target, write_recordings
from bagassets.sample.recipe import sample_recipe
from bagassets.sample.render import CameraView
from bagassets.sample.truth import Truth
from bagassets.store.store import Store
from bagassets_tests.recording_build import RecordingBuild

TARGETS = (("drive.bag", "ros1"), ("drive", "ros2"), ("drive.mcap", "mcap"))
VERSION = "v1.0-sample"


@dataclass
class Built:
    """A project with its truth, its artifacts by recording and asset, and the tables of its dataset."""

    recipe: object
    truth: Truth
    made: dict
    dataroot: Path
    tables: dict

    def artifact(self, key, asset):
        return self.made[key][asset].artifact

    def channel(self, key, asset, channel):
        """The artifact of one channel."""
        entry = self.artifact(key, asset).read_json("channels.json")[channel]
        return Store(self.recipe.store_path).artifact(entry["artifact"])


def build_recordings(recipe):
    """Build every recording of a recipe without Dagster: key -> asset -> what was made."""
    made = {}
    for key, recording in discover(recipe.bags).recordings.items():
        digest = recording_digest(recording).digest
        build = RecordingBuild(recipe, Store(recipe.store_path), recording, digest, recording_stat(recording))
        made[key] = {result.asset: result for result in build.build()}
    return made


def build_sample(folder, *, seed=3, duration_s=3.2, targets=TARGETS, profile="small"):
    """Write a drive in several formats and build the dataset."""
    files = [Target(folder / "recordings" / name, file_format) for name, file_format in targets]
    truth = write_recordings(files, seed, profile, duration_s)
    (folder / "recipe.yaml").write_text(sample_recipe(throughput=profile == "tas"))
    recipe = load_recipe(folder / "recipe.yaml")
    made = build_recordings(recipe)
    store = Store(recipe.store_path)
    parts = [Part(key, key, assets["nuscenes_tables"].artifact.digest) for key, assets in made.items()]
    assemble(NUSCENES, parts, recipe.nuscenes, store, recipe.nuscenes.output)
    version = recipe.nuscenes.output / VERSION
    tables = {file.stem: json.loads(file.read_text()) for file in version.glob("*.json")}
    return Built(recipe, truth, made, recipe.nuscenes.output, tables)


def pose_of(row):
    """The transform of a row of ego_pose, calibrated_sensor or sample_annotation."""
    return SE3.create(row["rotation"], row["translation"])


def object_ids(truth, channel, stamp_ns):
    """Return the object that each pixel (H, W) of an undistorted image sees: a track id, 0 the ground, -1 the sky."""
    model = truth.cameras[channel].model.undistorted()
    view = CameraView(truth.world, replace(truth.cameras[channel], model=model))
    return view.hits(truth.seconds(stamp_ns)).thing.reshape(model.height, model.width)


def number_in(image):
    """The number that an image of any camera of the sample arm shows, as 16 patches below it."""
    patches = np.split(
        image[-6:-2].mean(axis=(0, 2)), range(image.shape[1] // 16, image.shape[1], image.shape[1] // 16)
    )
    return sum(1 << bit for bit, patch in enumerate(patches[:16]) if patch[2:-2].mean() > 128)
