"""The asset `calibration`: the extrinsics of each sensor and the intrinsics of each camera.

Extrinsics come from the recipe or a file that it names, else from `/tf_static`, the URDF or the fixed joints of
`/tf`, in this order of trust (see `bagassets.assets.transform_logs`). If sources contradict each
other, that is noted and the most trusted one is used. File: `calibration.json`.
"""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path

from bagassets.assets.asset import Asset, Facts, Inputs, Summary, Use, as_json, by_digest, omitted
from bagassets.assets.calibration_files import FileContent, pose_in, read_file, short_names
from bagassets.assets.face import Face, Table
from bagassets.assets.intrinsics import camera_intrinsics, rounded
from bagassets.assets.inventory import INVENTORY
from bagassets.assets.quality.calibration_rules import calibration_plausible
from bagassets.assets.quality.check import RecordingCheck
from bagassets.assets.sensors import RecordedSensor, Sensor
from bagassets.assets.transform_logs import RigFrames, read_urdf
from bagassets.base.errors import CalibrationError
from bagassets.base.json_types import Json
from bagassets.geometry.calibration import UNPLACED, CalibratedSensor, Calibration
from bagassets.geometry.se3 import SE3
from bagassets.geometry.urdf import urdf_edges
from bagassets.recipe.model import Recipe, Rig
from bagassets.recipe.model_calibration import ExtrinsicsFile
from bagassets.recordings.inventory import Inventory
from bagassets.recordings.recording import Recording
from bagassets.store.artifact import Artifact, ArtifactWriter
from bagassets.store.canonical import digest_bytes


@dataclass(frozen=True)
class CalibrationParams:
    """Parameters of `calibration`.

    Attributes:
        ego_frame: frame of the vehicle, in which the extrinsics are given.
        channels: canonical channel -> its sensor.
        tf_static: topics with static transforms; like `tf` and `urdf` empty if the recipe has all extrinsics.
        tf: topics with transforms, some of which may be fixed joints.
        urdf: URDF file.
        anywhere: sensors may be anywhere, since no dataset of the recipe needs to know.
    """

    ego_frame: str
    channels: Mapping[str, Sensor]
    tf_static: tuple[str, ...]
    tf: tuple[str, ...]
    urdf: Path | None
    anywhere: bool = omitted(default=False)

    @classmethod
    def of(cls, recipe: Recipe, rig: Rig) -> "CalibrationParams":
        """Return the parameters of a rig."""
        channels = {name: Sensor.of(channel) for name, channel in sorted(rig.channels.items())}
        asked = recipe.dataset_settings.values()
        # What a format asks for is unknown as long as its package cannot be used.
        known = all(one in asked for one in recipe.formats.values())
        anywhere = bool(asked) and known and not any(one.needs_mounts for one in asked)
        if _placed_by_hand(channels.values(), rig.ego_frame):
            return cls(rig.ego_frame, channels, (), (), None, anywhere)
        return cls(rig.ego_frame, channels, rig.tf_static, rig.tf, rig.urdf, anywhere)


@dataclass(frozen=True)
class CalibrationUse:
    """What shapes the calibration of a recording: `CalibrationParams`, narrowed to what the recording has.

    Attributes:
        ego_frame: frame of the vehicle, in which the extrinsics are given.
        channels: channel with messages -> its sensor.
        tf_static: topics with static transforms.
        tf: topics with transforms.
        urdf: content of the URDF file.
        files: name -> content of the calibration files.
        anywhere: see `CalibrationParams`.
    """

    ego_frame: str
    channels: Mapping[str, RecordedSensor]
    tf_static: tuple[str, ...]
    tf: tuple[str, ...]
    urdf: bytes | None = by_digest()
    files: Mapping[str, FileContent] = by_digest()
    anywhere: bool = omitted(default=False)


def use(params: CalibrationParams, facts: Facts) -> dict[str, Use[CalibrationUse]]:
    """Return what calibration reads of a recording.

    Raises:
        CalibrationError: the URDF or a calibration file cannot be read, or a topic carries messages of several frames.
    """
    inventory = facts.inventory
    present = {name: sensor for name, sensor in params.channels.items() if inventory.has(sensor.topic)}
    names = short_names(sorted({path for sensor in present.values() for path in sensor.files}))
    files = {name: read_file(path, facts) for path, name in names.items()}
    inputs = {f"calibration:{name}": digest_bytes(file.data) for name, file in files.items()}
    channels = {
        name: _recorded(name, sensor.with_files(names), inventory) for name, sensor in present.items()
    }
    infos = {topic for sensor in channels.values() for topic in sensor.infos if inventory.has(topic)}
    static, moving, file = params.tf_static, params.tf, params.urdf
    if _placed_by_hand(present.values(), params.ego_frame):
        static, moving, file = (), (), None
    static, moving = tuple(filter(inventory.has, static)), tuple(filter(inventory.has, moving))
    urdf = None if file is None else read_urdf(file, facts)
    inputs |= {} if urdf is None else {"urdf": digest_bytes(urdf)}
    known = CalibrationUse(params.ego_frame, channels, static, moving, urdf, files, params.anywhere)
    return {"": Use(known, tuple(sorted({*infos, *static, *moving})), inputs)}


def _placed_by_hand(sensors: Iterable[Sensor], ego_frame: str) -> bool:
    """Return whether the recipe and its files have the extrinsics of all sensors, so that no transform counts."""
    return not any(sensor.needs_transforms(ego_frame) for sensor in sensors)


def _recorded(name: str, sensor: Sensor, inventory: Inventory) -> RecordedSensor:
    """Return a sensor with facts from its messages, which must all be in one frame."""
    record = inventory.topic(sensor.topic)
    frames = record.frame_ids
    if sensor.frame is None and sensor.extrinsics is None and not frames and record.problem is not None:
        raise CalibrationError(
            f"{name}: {sensor.topic} cannot be decoded, not even its frame: {record.problem}; choose another topic in the "
            "recipe, or remove the channel."
        )
    if sensor.frame is None and sensor.extrinsics is None and len(frames) > 1:
        raise CalibrationError(
            f"{name}: the messages of {sensor.topic} are in several frames ({', '.join(frames)}), but a channel is "
            "one sensor; name the one to use in `frame`, or give `extrinsics` in the recipe."
        )
    return RecordedSensor.of(sensor, inventory)


def make_calibration(use: CalibrationUse, recording: Recording, out: ArtifactWriter) -> Summary:
    """Write `calibration.json` and return the summary.

    Raises:
        CalibrationError: extrinsics or intrinsics that a channel needs are missing or implausible.
    """
    joints = [] if use.urdf is None else urdf_edges(use.urdf)
    frames = RigFrames(recording, use.tf_static, use.tf, joints)
    notes: list[str] = []
    channels: dict[str, CalibratedSensor] = {}
    sources: dict[str, int] = {}
    for name, sensor in use.channels.items():
        try:
            ego_SE3_sensor, source = _extrinsics(name, sensor, use, frames, notes)
        except CalibrationError as err:
            if not use.anywhere:
                raise
            ego_SE3_sensor, source = SE3(), UNPLACED
            notes.append(f"Where {name} is remains unknown, and no dataset needs it: {err}")
        camera = None
        if sensor.sensor.lens is not None:
            camera, frame_SE3_image = camera_intrinsics(
                name, sensor, sensor.sensor.lens, recording, use.files, notes
            )
            ego_SE3_sensor = ego_SE3_sensor @ frame_SE3_image
        sources[source] = sources.get(source, 0) + 1
        channels[name] = CalibratedSensor(sensor.frame, _rounded(ego_SE3_sensor), source, camera)
    out.write_json("calibration.json", as_json(Calibration(use.ego_frame, channels, tuple(notes))))
    cameras = sum(channel.camera is not None for channel in channels.values())
    return {
        "sensors": len(channels),
        "cameras": cameras,
        "sources": sources,
        "transforms": frames.counts.as_json(),
        "notes": notes,
    }


def _rounded(transform: SE3) -> SE3:
    (w, x, y, z), (tx, ty, tz) = transform.rotation, transform.translation
    return SE3((rounded(w), rounded(x), rounded(y), rounded(z)), (rounded(tx), rounded(ty), rounded(tz)))


def _extrinsics(
    name: str, recorded: RecordedSensor, use: CalibrationUse, frames: RigFrames, notes: list[str]
) -> tuple[SE3, str]:
    sensor, frame, ego_frame = recorded.sensor, recorded.frame, use.ego_frame
    given = sensor.extrinsics
    if isinstance(given, ExtrinsicsFile):
        return _extrinsics_in_file(name, recorded, given, use, frames, notes)
    if given is not None:
        return SE3.create(given.rotation, given.translation), "recipe"
    if not frame:
        raise CalibrationError(
            f"{name}: the messages of {sensor.topic} name no frame; give `frame` or `extrinsics` in the recipe."
        )
    if frame == ego_frame:
        return SE3(), "ego frame"
    ego_SE3_sensor, sources = _fixed(
        f"{name} ({sensor.topic})",
        ego_frame,
        frame,
        frames,
        "Correct ego_frame or the channel's frame in the recipe, or give the channel `extrinsics: {translation: [x, y, z], "
        "rotation: [w, x, y, z]}`; leave the channel out if its mount moves.",
    )
    notes += [f"{name}: {note}." for note in frames.disagreements(ego_frame, frame)]
    return ego_SE3_sensor, "+".join(sources)


def _extrinsics_in_file(
    name: str,
    recorded: RecordedSensor,
    given: ExtrinsicsFile,
    use: CalibrationUse,
    frames: RigFrames,
    notes: list[str],
) -> tuple[SE3, str]:
    pose = pose_in(name, given, recorded.sensor.topic, use.files)
    source, reference = given.file.as_posix(), given.relative_to
    notes += [f"{name}: {source}: {note}." for note in pose.notes]
    if reference is None:
        notes.append(
            f"{name}: {source} places it relative to {pose.reference}, whose frame is taken for {use.ego_frame}; name that "
            "frame in `relative_to` of `extrinsics`."
        )
    if reference is None or reference == use.ego_frame:
        return pose.reference_SE3_sensor, source
    ego_SE3_reference, sources = _fixed(
        f"{name}: {source}, relative_to: {reference}",
        use.ego_frame,
        reference,
        frames,
        f"Correct `relative_to`, or name a `urdf` with {reference}.",
    )
    return ego_SE3_reference @ pose.reference_SE3_sensor, "+".join([source, *sources])


def _fixed(
    what: str, ego_frame: str, frame: str, frames: RigFrames, advice: str
) -> tuple[SE3, tuple[str, ...]]:
    """Return `ego_SE3_frame` and its sources."""
    try:
        return frames.fixed(ego_frame, frame)
    except CalibrationError as err:
        damaged = ", ".join(f"{topic} ({reason})" for topic, reason in sorted(frames.troubles.items()))
        if damaged:
            advice = f"Transforms could not be decoded in {damaged}, so frames may be missing. {advice}"
        raise CalibrationError(f"{what}: {err}. {advice}") from err


def _make(use: Use[CalibrationUse], inputs: Inputs, out: ArtifactWriter) -> Summary:
    with inputs.messages(use.topics) as recording:
        return make_calibration(use.params, recording, out)


def _shown(artifact: Artifact) -> Mapping[str, Json | Table]:
    """Return first where each sensor sits on the vehicle, and its lens."""
    rows = []
    channels = Calibration.from_json(artifact.read_json("calibration.json")).channels
    for name, sensor in sorted(channels.items()):
        place_m = ", ".join(f"{value:.3f}" for value in sensor.ego_SE3_sensor.translation)
        camera = sensor.camera
        lens = "" if camera is None else f"{camera.width} x {camera.height}, {camera.model}"
        rows.append((name, sensor.frame, place_m, sensor.source, lens))
    header = ("channel", "frame", "x, y, z in the ego frame (m)", "from", "camera")
    return {"mounting": Table(header, rows), **artifact.summary()}


CALIBRATION = Asset(
    name="calibration",
    version=4,
    changes={4: "takes P of a CameraInfo whose K is zero"},
    title="Where each sensor sits on the vehicle, and the lens of each camera.",
    description="""Extrinsics `ego <- sensor` are resolved from TF, a URDF file, the recipe or a calibration file; intrinsics and distortion come from
CameraInfo, the recipe or a calibration file: `calibration.json`.""",
    kinds=frozenset({"json"}),
    face=Face(shown=_shown, heading="calibr."),
    reads=(INVENTORY,),
    params=CalibrationParams.of,
    use=use,
    make=_make,
    checks=(
        RecordingCheck(
            "calibration_plausible",
            "calibration_plausible",
            "Sensors sit on the vehicle, cameras look out of it through real lenses.",
            "a sensor sits farther than `max_distance_m` from the ego frame; a camera looks up or down by more than "
            "`max_tilt_deg` (its frame is not the optical one); the field of view, the ratio fx:fy or the principal point "
            "are not those of a real camera; the distortion folds the image over; a camera has no intrinsics; two sensors share "
            "their extrinsics",
            lambda e: calibration_plausible(e.calibration, e.rig, e.checks.calibration_plausible),
        ),
    ),
)
