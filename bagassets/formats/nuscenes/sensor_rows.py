"""Rows about readings: log, scene, sample, calibrated_sensor, sample_data, ego_pose."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime

from bagassets.base.json_types import JsonMapping, JsonObject
from bagassets.formats.json_files import rounded
from bagassets.formats.nuscenes.readings import ChannelReadings
from bagassets.formats.nuscenes.scene_plan import ScenePlan
from bagassets.formats.nuscenes.table_file import quaternion
from bagassets.formats.nuscenes.tokens import RecordingTokens, filename, sensor_token

NS_PER_US = 1000


@dataclass
class SensorRows:
    """Rows about readings, and the file of each reading.

    Attributes:
        tables: table -> rows.
        files: `filename` in the dataset, `artifact` and `file` in the store.
        keyframes: channel -> number of readings at keyframes.
        sweeps: channel -> number of readings between keyframes.
    """

    tables: dict[str, list[JsonObject]] = field(default_factory=dict)
    files: list[dict[str, str]] = field(default_factory=list)
    keyframes: dict[str, int] = field(default_factory=dict)
    sweeps: dict[str, int] = field(default_factory=dict)


def microseconds(stamp_ns: int) -> int:
    """Return a stamp in nuScenes units: whole microseconds since the epoch, rounded down."""
    return stamp_ns // NS_PER_US


def sensor_rows(
    tokens: RecordingTokens,
    channels: Mapping[str, ChannelReadings],
    scenes: Sequence[ScenePlan],
    log: JsonMapping,
) -> SensorRows:
    """Return the rows of all scenes of a recording; no rows at all without a scene.

    Args:
        tokens: tokens of the recording.
        channels: readings of all channels.
        scenes: scenes of the recording.
        log: its row of the log table, but for token and date.
    """
    tables = ("log", "scene", "sample", "calibrated_sensor", "ego_pose", "sample_data")
    rows = SensorRows({name: [] for name in tables})
    if not scenes:
        return rows
    first_s = int(scenes[0].keyframes_ns[0]) // 1_000_000_000
    date = datetime.fromtimestamp(first_s, UTC).date().isoformat()
    rows.tables["log"].append({**log, "token": tokens.row("log"), "date_captured": date})
    for number, scene in enumerate(scenes):
        _add_scene(rows, tokens, number, scene)
    for name, readings in sorted(channels.items()):
        rows.keyframes[name] = rows.sweeps[name] = 0
        for scene in scenes:
            _add_readings(rows, tokens, readings, scene)
        if rows.keyframes[name] or rows.sweeps[name]:
            rows.tables["calibrated_sensor"].append(
                {
                    "token": tokens.row("calibrated_sensor", name),
                    "sensor_token": sensor_token(name, readings.modality),
                    "translation": rounded(readings.ego_SE3_sensor.translation),
                    "rotation": quaternion(readings.ego_SE3_sensor.rotation),
                    "camera_intrinsic": readings.intrinsic,
                }
            )
    return rows


def _add_scene(rows: SensorRows, tokens: RecordingTokens, number: int, scene: ScenePlan) -> None:
    stamps = scene.keyframes_ns.tolist()
    samples = [tokens.row("sample", "", stamp) for stamp in stamps]
    scene_token = tokens.row("scene", "", stamps[0])
    rows.tables["scene"].append(
        {
            "token": scene_token,
            "log_token": tokens.row("log"),
            "nbr_samples": len(samples),
            "first_sample_token": samples[0],
            "last_sample_token": samples[-1],
            "name": f"{tokens.key}_{number:03d}",
            "description": f"{scene.span.duration_s:.1f} s, rig {tokens.rig}",
        }
    )
    for token, stamp, before, after in zip(samples, stamps, ["", *samples], [*samples[1:], ""], strict=False):
        rows.tables["sample"].append(
            {
                "token": token,
                "timestamp": microseconds(stamp),
                "prev": before,
                "next": after,
                "scene_token": scene_token,
            }
        )


def _add_readings(
    rows: SensorRows, tokens: RecordingTokens, readings: ChannelReadings, scene: ScenePlan
) -> None:
    plan = scene.channels[readings.channel]
    numbers = plan.readings.tolist()
    stamps = [int(readings.stamps_ns[number]) for number in numbers]
    data = [tokens.row("sample_data", readings.channel, stamp) for stamp in stamps]
    for position, (number, stamp) in enumerate(zip(numbers, stamps, strict=True)):
        is_keyframe = bool(plan.is_keyframe[position])
        sample_ns = int(scene.keyframes_ns[plan.sample[position]])
        path = filename(
            tokens.key,
            readings.channel,
            microseconds(stamp),
            readings.digests[number],
            readings.files[number].partition(".")[2],
            is_keyframe=is_keyframe,
        )
        # As in nuScenes itself, on which the devkit's `export_poses` relies, a pose has the token of its reading.
        token = data[position]
        width, height = readings.sizes_px[number]
        rows.tables["ego_pose"].append(
            {
                "token": token,
                "timestamp": microseconds(stamp),
                "rotation": readings.rotations[number],
                "translation": readings.translations[number],
            }
        )
        rows.tables["sample_data"].append(
            {
                "token": token,
                "sample_token": tokens.row("sample", "", sample_ns),
                "ego_pose_token": token,
                "calibrated_sensor_token": tokens.row("calibrated_sensor", readings.channel),
                "timestamp": microseconds(stamp),
                "fileformat": readings.fileformat,
                "is_key_frame": is_keyframe,
                "height": height,
                "width": width,
                "filename": path,
                "prev": data[position - 1] if position else "",
                "next": data[position + 1] if position + 1 < len(data) else "",
            }
        )
        rows.files.append(
            {"filename": path, "artifact": readings.artifact.digest, "file": readings.files[number]}
        )
        (rows.keyframes if is_keyframe else rows.sweeps)[readings.channel] += 1
