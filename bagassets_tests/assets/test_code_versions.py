"""The code version of an asset, as Dagster shows it, changes with the recipe fields that shape the asset and no others."""

import pytest
import yaml

from bagassets.assets import frames, inventory
from bagassets.formats.catalogue import recording_assets
from bagassets.recipe.model import Recipe

pytestmark = pytest.mark.once

ASSETS = (
    "inventory", "calibration", "ego_poses", "annotations", "frames", "sweeps", "nuscenes_tables", "vision_sequences",
    "preview",
)  # fmt: skip

RECIPE = """
name: test
bags: {root: bags}
nuscenes: {}
vision: {frames: 4}
rigs:
  - name: car
    vehicle: van
    location: yard
    ego_pose: {source: odometry, topic: /odom}
    annotations: [{topic: /boxes}]
    channels:
      CAM_FRONT: {modality: camera, topic: /cam}
      LIDAR_TOP: {modality: lidar, topic: /points}
"""


def versions(**changes):
    """Asset -> code version of the recipe after some of its fields, named by dots, were set."""
    data = yaml.safe_load(RECIPE)
    for name, value in changes.items():
        *way, last = name.split("__")
        place = data
        for step in way:
            place = place[0][step] if isinstance(place, list) else place.setdefault(step, {})
        (place[0] if isinstance(place, list) else place)[last] = value
    recipe = Recipe.model_validate(data)
    return recording_assets(recipe).versions


COMMON = {"ego_poses", "annotations", "frames", "sweeps"}


@pytest.mark.parametrize(
    ("field", "value", "changed"),
    [
        ("name", "other", set()),
        ("bags__include", ["a*"], set()),
        ("bags__min_duration_s", 2.0, set()),
        ("clock", "log", COMMON),
        ("limits__lost_messages", 0.25, COMMON),
        ("limits__reported_losses", 0.25, set()),
        ("rigs__match", ["*"], set()),
        ("rigs__required", ["CAM_FRONT"], set()),
        ("rigs__ego_frame", "base", {"calibration", "ego_poses", "annotations"}),
        ("rigs__tf", ["/tf2"], {"calibration", "ego_poses", "annotations"}),
        ("rigs__tf_static", ["/tf2"], {"calibration", "ego_poses", "annotations"}),
        ("rigs__urdf", "car.urdf", {"calibration", "ego_poses"}),
        ("rigs__ego_pose", {"source": "odometry", "topic": "/odometry"}, {"ego_poses"}),
        ("rigs__annotations", [{"topic": "/other"}], {"annotations"}),
        ("rigs__annotation_files", [{"format": "boxes", "path": "{stem}.json"}], {"annotations"}),
        ("rigs__name", "bus", {"nuscenes_tables", "vision_sequences"}),
        ("rigs__vehicle", "bus", {"nuscenes_tables"}),
        ("rigs__location", "street", {"nuscenes_tables"}),
        ("rigs__channels__CAM_FRONT__topic", "/camera", {"calibration", "frames"}),
        ("rigs__channels__CAM_FRONT__frame", "cam", {"calibration"}),
        ("rigs__channels__CAM_FRONT__camera_info", "/info", {"calibration"}),
        ("rigs__channels__CAM_FRONT__undistort", False, {"calibration", "frames", "preview"}),
        ("rigs__channels__CAM_FRONT__rectified", True, {"calibration"}),
        ("rigs__channels__CAM_FRONT__quality", 50, {"frames"}),
        ("rigs__clock", "log", COMMON),
        ("rigs__clock", "header", set()),
        ("rigs__channels__CAM_FRONT__clock", "log", {"frames"}),
        ("rigs__channels__CAM_FRONT__clock", "header", set()),
        ("rigs__channels__LIDAR_TOP__clock", "log", {"sweeps"}),
        ("rigs__channels__LIDAR_TOP__topic", "/lidar", {"calibration", "sweeps"}),
        ("rigs__channels__LIDAR_TOP__min_range_m", 1.5, {"sweeps"}),
        ("rigs__channels__LIDAR_TOP__zero_points", "keep", {"sweeps"}),
        ("rigs__channels__LIDAR_TOP__point_times", "ignore", {"sweeps"}),
        ("rigs__channels__LIDAR_TOP__intensity_scale", 255, {"sweeps"}),
        ("scenes__length_s", 10.0, {"nuscenes_tables"}),
        ("nuscenes__version", "v1.0-other", set()),
        ("vision__frames", 5, {"vision_sequences"}),
        ("vision__trajectories", ["ego:lane"], {"vision_sequences"}),
        ("vision__output", "elsewhere", set()),
        ("vision__files", "one", set()),
        ("preview__columns", 3, {"preview"}),
        ("preview__enabled", False, set()),
        ("preview__trajectory_map", False, set()),
    ],
)
def test_what_a_field_changes(field, value, changed):
    before, after = versions(), versions(**{field: value})
    assert {asset for asset in ASSETS if before[asset] != after.get(asset, before[asset])} == changed


def test_a_channel_more_changes_what_has_channels():
    camera = {"modality": "camera", "topic": "/back"}
    before, after = versions(), versions(rigs__channels__CAM_BACK=camera)
    assert {asset for asset in ASSETS if before[asset] != after[asset]} == {
        "calibration", "frames", "nuscenes_tables", "vision_sequences", "preview",
    }  # fmt: skip


def test_it_begins_with_the_version_of_the_step():
    now = versions()
    assert now["frames"].split("-")[0] == str(frames.FRAMES.version)
    assert now["inventory"].split("-")[0] == str(inventory.INVENTORY.version)
    assert all(len(version.split("-")[1]) == 12 for version in now.values())
