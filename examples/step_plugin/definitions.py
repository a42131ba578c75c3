"""Two steps in addition to those of bagassets: sharpness of each camera, per recording and for the dataset.

`workspace.yaml` loads this module: all assets of bagassets, and these two downstream.
"""

import csv
import io
from pathlib import Path
from typing import Any

import cv2
import dagster as dg
import numpy as np

from bagassets.defs import (
    Workspace,
    all_recordings,
    build_definitions,
    channels,
    errors_explained,
    follow_recordings,
    per_recording,
    publish,
    recipe_beside,
    skipped,
)
from bagassets.store.artifact import Artifact, ArtifactWriter

RECIPE = recipe_beside(__file__)


def sharpness(channel: Artifact) -> list[float]:
    """Return the variance of the Laplacian of each image, in order of time; small means blurred."""
    files = channel.read_table("index.parquet")["file"].to_pylist()
    images = (cv2.imread(str(channel.path(file)), cv2.IMREAD_GRAYSCALE) for file in files)
    return [round(float(cv2.Laplacian(image, cv2.CV_64F).var()), 3) for image in images if image is not None]


@dg.asset(
    partitions_def=per_recording(RECIPE),
    deps=["frames"],
    group_name="own",
    kinds={"json"},
    code_version="1",
    automation_condition=dg.AutomationCondition.eager(),
)
def image_quality(context: dg.AssetExecutionContext, workspace: Workspace) -> dg.MaterializeResult[None]:
    """Sharpness of the images of each camera of one recording."""
    if (passed_on := skipped(context, workspace, "frames")) is not None:
        return passed_on
    with errors_explained():
        cameras = channels(context, workspace, "frames")

    def make(out: ArtifactWriter) -> dict[str, Any]:
        values = {name: sharpness(camera) for name, camera in cameras.items()}
        out.write_json("sharpness.json", values)
        return {"images": sum(map(len, values.values()))} | {
            f"sharpness_{name}": float(np.median(each)) for name, each in values.items()
        }

    return publish(context, workspace, make, inputs=cameras, libraries=("opencv-python-headless",))


@dg.asset(
    deps=[dg.AssetDep("image_quality", partition_mapping=dg.AllPartitionMapping())],
    group_name="own",
    kinds={"csv"},
    code_version="1",
)
def quality_report(context: dg.AssetExecutionContext, workspace: Workspace) -> dg.MaterializeResult[None]:
    """A table of all recordings and cameras, the most blurred first."""
    with errors_explained():
        recordings = all_recordings(context, workspace, "image_quality")

    def make(out: ArtifactWriter) -> dict[str, Any]:
        rows = [
            (float(np.median(values)), key, camera, len(values))
            for key, artifact in recordings.items()
            for camera, values in artifact.read_json("sharpness.json").items()
        ]
        text = io.StringIO()
        table = csv.writer(text, lineterminator="\n")
        table.writerow(["sharpness", "recording", "camera", "images"])
        table.writerows(sorted(rows))
        out.write("report.csv", text.getvalue().encode())
        return {"recordings": len(recordings), "cameras": len(rows)}

    return publish(context, workspace, make, inputs=recordings)


defs = dg.Definitions.merge(
    build_definitions(Path(__file__).with_name("recipe.yaml")),
    dg.Definitions(
        assets=[image_quality, quality_report],
        sensors=[
            # Requests runs for recordings with new images, by the automation condition.
            dg.AutomationConditionSensorDefinition(
                "image_quality_of_new_images",
                target=[image_quality],
                default_status=dg.DefaultSensorStatus.RUNNING,
            ),
            # Requests the report whenever a recording was added, changed or removed.
            follow_recordings("quality_report", upstream="image_quality"),
        ],
    ),
)
