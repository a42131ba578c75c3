"""The asset `preview`: pictures of a recording for people.

Files: `lidar_over_camera.jpg`, `birds_eye.jpg`, `future_trajectory.jpg`, `contact_sheet.jpg`,
`timeline.jpg` in full size; the same below `inline/`, small enough for reports; `thumbnail.jpg` for the
report. `facts.json` lists them, and why others are missing: a picture that cannot be drawn does not affect the
others.
"""

from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

from bagassets.assets.annotations import ANNOTATIONS
from bagassets.assets.asset import Asset, Facts, Inputs, Summary, Use, inlined
from bagassets.assets.boxes.table import BoxTable
from bagassets.assets.calibration import CALIBRATION
from bagassets.assets.ego_poses import EGO_POSES
from bagassets.assets.face import Face, Picture
from bagassets.assets.frames import FRAMES
from bagassets.assets.inventory import INVENTORY
from bagassets.assets.pictures.canvas import Image, jpeg, jpeg_within
from bagassets.assets.pictures.channels import CameraImages, Clouds
from bagassets.assets.pictures.pictures import TITLES, CannotDrawError, Pictures, Style
from bagassets.assets.pictures.timeline import timeline, timeline_facts
from bagassets.assets.sweeps import SWEEPS
from bagassets.geometry.calibration import CalibratedCamera
from bagassets.geometry.se3 import SE3
from bagassets.recipe.model import CameraChannel, LidarChannel, Recipe, Rig
from bagassets.store.artifact import Artifact, ArtifactWriter
from bagassets.store.canonical import digest_json

FACTS = "facts.json"
THUMBNAIL = "thumbnail.jpg"
# What thumbnails for the web UI are made from, and what small reports show.
INLINE_BYTES = 16 * 1024
INLINE_WIDTH_PX = 560
THUMBNAIL_BYTES = 2600
THUMBNAIL_WIDTH_PX = 200
_THREADS = 2
_LONGEST = "contact_sheet"  # decodes two dozen images, so it is begun first
# The first of these that there is stands for the recording.
_THUMBNAILS = ("lidar_over_camera", "contact_sheet", "birds_eye", "timeline")


@dataclass(frozen=True)
class PreviewParams:
    """What the pictures of a recording may know of the recipe.

    Attributes:
        cameras: in order of preference, the one of the single pictures first.
        lidars: in order of preference; the first one that the recording has is drawn.
        distorted: those of the cameras whose images keep the distortion of their lens.
        style: how pictures are drawn.
    """

    cameras: tuple[str, ...]
    lidars: tuple[str, ...]
    distorted: frozenset[str]
    style: Style

    @classmethod
    def of(cls, recipe: Recipe, rig: Rig) -> "PreviewParams":
        """Return those of a rig."""
        preview = recipe.preview
        cameras = {n: channel for n, channel in rig.channels.items() if isinstance(channel, CameraChannel)}
        lidars = [n for n, channel in rig.channels.items() if isinstance(channel, LidarChannel)]
        return cls(
            cameras=_first(preview.camera or "CAM_FRONT", list(cameras)),
            lidars=_first(preview.lidar or "LIDAR_TOP", lidars),
            distorted=frozenset(name for name, camera in cameras.items() if not camera.undistort),
            style=Style(preview.columns, preview.width, preview.future_s, preview.range_m),
        )


def _first(wanted: str, names: list[str]) -> tuple[str, ...]:
    """Return the names with the wanted one, if it is there, at the front."""
    return tuple(sorted(names, key=lambda name: name != wanted))


@dataclass(frozen=True)
class PreviewUse:
    """What shapes the pictures of a recording besides its artifacts.

    Attributes:
        cameras: camera -> the lens that its images were written with; None if they are free of distortion.
        order: the cameras, the one of the single pictures first.
        lidar: the lidar that is drawn.
        extrinsics: channel -> `ego_SE3_sensor`.
        style: how pictures are drawn.
    """

    cameras: Mapping[str, CalibratedCamera | None]
    order: tuple[str, ...]
    lidar: str | None
    extrinsics: Mapping[str, SE3]
    style: Style = inlined()


def use(params: PreviewParams, facts: Facts) -> dict[str, Use[PreviewUse]]:
    """Return what the pictures of a recording depend on: images, one lidar, poses, boxes and the timeline of topics."""
    images, clouds = facts.channels(FRAMES.name), facts.channels(SWEEPS.name)
    cameras = tuple(name for name in params.cameras if name in images)
    lidar = next((name for name in params.lidars if name in clouds), None)
    shown = {name: images[name] for name in cameras} | ({} if lidar is None else {lidar: clouds[lidar]})
    calibrated = facts.calibration.channels
    read = PreviewUse(
        cameras={name: calibrated[name].camera if name in params.distorted else None for name in cameras},
        order=cameras,
        lidar=lidar,
        extrinsics={name: calibrated[name].ego_SE3_sensor for name in shown},
        style=params.style,
    )
    inputs = {f"channel:{name}": artifact.digest for name, artifact in shown.items()}
    inputs |= {one.name: facts.artifact(one.name).digest for one in (EGO_POSES, ANNOTATIONS)}
    return {"": Use(read, inputs=inputs | {"timeline": digest_json(timeline_facts(facts.inventory))})}


def make(use: Use[PreviewUse], inputs: Inputs, out: ArtifactWriter) -> Summary:
    """Draw the pictures; return the summary."""
    params = use.params
    images, extrinsics, lidar = inputs.channels(FRAMES.name), params.extrinsics, params.lidar
    cameras = {
        name: CameraImages.of(name, images[name], extrinsics[name], params.cameras[name])
        for name in params.order
    }
    pictures = Pictures(
        cameras={name: camera for name, camera in cameras.items() if len(camera.files)},
        clouds=None
        if lidar is None
        else Clouds.of(lidar, inputs.channels(SWEEPS.name)[lidar], extrinsics[lidar]),
        trajectory=inputs.trajectory,
        boxes=BoxTable.from_arrow(inputs.artifact(ANNOTATIONS.name).read_table("annotations.parquet")),
        timeline_facts=timeline_facts(inputs.inventory),
        style=params.style,
    )
    _ = pictures.moment_ns  # found once, not by each thread

    def paint(name: str) -> tuple[Image, bytes, bytes] | str:
        """Return a picture, as JPEG, and as a small JPEG; or why it is missing."""
        try:
            picture = pictures.draw(name)
        except CannotDrawError as err:
            return str(err)
        # Text shrinks with a picture, so the timeline is drawn again.
        small = timeline(pictures.timeline_facts, INLINE_WIDTH_PX) if name == "timeline" else picture
        return picture, jpeg(picture), jpeg_within(small, INLINE_BYTES, INLINE_WIDTH_PX)

    drawn: dict[str, Image] = {}
    missing: dict[str, str] = {}
    with ThreadPoolExecutor(_THREADS) as pool:  # most of it is OpenCV, which leaves Python to others
        names = sorted(TITLES, key=lambda name: name != _LONGEST)
        painted = dict(zip(names, pool.map(paint, names), strict=True))
    for name in TITLES:
        one = painted[name]
        if isinstance(one, str):
            missing[name] = one
        else:
            drawn[name], whole, small = one
            out.write(f"{name}.jpg", whole)
            out.write(f"inline/{name}.jpg", small)
    stands_for_all = next(drawn[name] for name in _THUMBNAILS if name in drawn)
    out.write(THUMBNAIL, jpeg_within(stands_for_all, THUMBNAIL_BYTES, THUMBNAIL_WIDTH_PX))
    facts = {"pictures": list(drawn), "missing": missing, "moment_ns": pictures.moment_ns}
    out.write_json(FACTS, facts)
    return facts


def _pictures(artifact: Artifact) -> list[Picture]:
    drawn = artifact.read_json(FACTS)["pictures"]
    return [Picture(name, TITLES[name], f"{name}.jpg", f"inline/{name}.jpg") for name in drawn]


PREVIEW = Asset(
    name="preview",
    version=11,
    changes={
        7: "fits the view from above to small robots and long ranges",
        8: "rounds its timeline to milliseconds and rates, so that a message more seldom changes it",
        9: "averages over whole pixels",
        10: "shows images of 16 bits in the range of their levels",
        11: "is scaled alike on every processor, and not turned by EXIF",
    },
    libraries=("opencv-python-headless",),
    title="Pictures of the recording for people; the small ones are shown with each materialization.",
    kinds=frozenset({"image"}),
    face=Face(pictures=_pictures, thumbnail=THUMBNAIL),
    reads=(INVENTORY, CALIBRATION, EGO_POSES, ANNOTATIONS, FRAMES, SWEEPS),
    enabled=lambda recipe: recipe.preview.enabled,
    optional=True,
    params=PreviewParams.of,
    use=use,
    make=make,
)
