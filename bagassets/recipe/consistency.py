"""Problems of a well-formed recipe: checks across fields, and against the disk."""

from collections.abc import Iterable, Iterator
from pathlib import Path, PurePosixPath

from pydantic import BaseModel

from bagassets.base.json_types import JsonObject
from bagassets.recipe.format_settings import DEFAULT_FORMAT, section_at
from bagassets.recipe.model import CameraChannel, LidarChannel, RadarChannel, Recipe, Rig
from bagassets.recipe.model_calibration import Intrinsics
from bagassets.recipe.model_poses import FixedPose, NavSatSource, TfSource
from bagassets.recipe.problems import Problem, value_at
from bagassets.recipe.schema import suggestion

_COEFFICIENTS = {"plumb_bob": (0, 4, 5), "rational_polynomial": (0, 8, 12, 14), "equidistant": (0, 4)}
"""Model -> possible numbers of distortion coefficients in OpenCV and ROS."""


def problems_in(recipe: Recipe, data: JsonObject) -> Iterator[Problem]:
    """Yield the problems of a recipe whose fields are valid by themselves.

    Args:
        recipe: the recipe, its paths absolute.
        data: the recipe as plain data, with paths as the user wrote them.
    """
    yield from _paths(recipe, data)
    yield from _globs(recipe)
    lists = [(name, parts) for name, parts in recipe.bags.series.items() if not isinstance(parts, bool)]
    yield from _repeated(
        (("bags", "series", name, n), part) for name, parts in lists for n, part in enumerate(parts)
    )
    yield from _scenes(recipe)
    yield from _named_channels(recipe)
    for name, section in recipe.dataset_settings.items():
        for at, sentence in section.problems_in(recipe):
            yield (*section_at(name), *at), sentence
    for number, rig in enumerate(recipe.rigs):
        for at, sentence in _rig(rig):
            yield ("rigs", number, *at), sentence


def paths_in(value: object, at: tuple[str | int, ...] = ()) -> Iterator[tuple[tuple[str | int, ...], Path]]:
    """Yield the paths in a recipe, or in a part of it, each after its location."""
    if isinstance(value, Path):
        yield at, value
    elif isinstance(value, BaseModel | dict | tuple | list):
        entries: Iterable[tuple[str | int, object]] = enumerate(value)
        if isinstance(value, BaseModel | dict):
            entries = value.items() if isinstance(value, dict) else value
        for name, inner in entries:
            yield from paths_in(inner, (*at, name))


def _paths(recipe: Recipe, data: JsonObject) -> Iterator[Problem]:
    for at, path in paths_in(recipe):
        match at:
            case ("formats", _, name, *_) if name != "output":  # only the package knows what it means
                pass
            case _ if str(value_at(data, at)).startswith("~"):
                yield (
                    at,
                    "`~` is not expanded, because the web UI may run as another user; give an absolute path, or one relative to the recipe's folder",
                )
            case ("rigs", _, "urdf") if not path.is_file():
                yield (
                    at,
                    f"there is no file {path}; give an absolute path to the URDF, or one relative to the recipe's folder",
                )
            case ("rigs", _, "channels", _, _, "file") if not path.is_file():
                yield (
                    at,
                    f"{path} is a folder; name the calibration file in it"
                    if path.is_dir()
                    else f"there is no file {path}; give an absolute path to the calibration file, or one relative to the "
                    "recipe's folder",
                )
            case ("rigs", _, "channels", _, "metadata") if not path.is_file():
                yield at, f"there is no file {path}; name the file with the metadata of the lidar"
            case ("bags", "message_definitions", _) if not path.is_dir():
                yield at, f"there is no folder {path}; name a folder of .msg files"
    if recipe.bags.root.is_file():
        yield ("bags", "root"), f"{recipe.bags.root} is a file; name the folder with the recordings"
    yield from _outputs(recipe)


def _outputs(recipe: Recipe) -> Iterator[Problem]:
    """Check that each dataset has its own folder, or its own one in an output that others share."""
    sections = recipe.dataset_settings
    outputs: list[tuple[str, tuple[str | int, ...], Path, str | None]] = [
        (name, (*section_at(name), "output"), one.output, one.own_folder) for name, one in sections.items()
    ]
    for number, one in enumerate(recipe.datasets):
        if one.output is not None:
            own = one.version or sections[DEFAULT_FORMAT].own_folder
            outputs.append((one.name, ("datasets", number, "output"), one.output, own))
    taken: list[tuple[str, Path, str | None]] = [("state folder", recipe.state, None)]
    if recipe.store is not None:
        taken.append(("store", recipe.store, None))
    for name, at, output, own in outputs:
        for owner, folder, other in taken:
            both = output == folder and own is not None and other is not None and own != other
            if not both and (output == folder or folder in output.parents or output in folder.parents):
                yield (
                    at,
                    f"{output} and the {owner} {folder} must be different, and neither may contain the other",
                )
        taken.append((f"output of {name}", output, own))


def _named_channels(recipe: Recipe) -> Iterator[Problem]:
    """Check that some rig has the channels of pictures, and the channels and signals of checks."""
    for kind, wanted in (("camera", recipe.preview.camera), ("lidar", recipe.preview.lidar)):
        known = recipe.channels(kind)
        if wanted is not None and wanted not in known:
            yield ("preview", kind), f"no rig has a {kind} {wanted}{suggestion(wanted, known)}"
    signals = [name for rig in recipe.rigs for name in rig.signals]
    for name in recipe.checks.signal_values.limits:
        if name not in signals:
            at = ("checks", "signal_values", "limits", name)
            yield at, f"no rig has a signal {name}{suggestion(name, signals)}"
    known = [*signals, *(name for rig in recipe.rigs for name in rig.channels)]
    for number, name in enumerate(recipe.checks.channels_present.optional):
        if name not in known:
            hint = suggestion(name, known)
            yield (
                ("checks", "channels_present", "optional", number),
                f"no rig has a channel or signal {name}{hint}",
            )


def _globs(recipe: Recipe) -> Iterator[Problem]:
    globs: list[tuple[tuple[str | int, ...], str]] = [
        *((("bags", "include", n), glob) for n, glob in enumerate(recipe.bags.include)),
        *((("bags", "exclude", n), glob) for n, glob in enumerate(recipe.bags.exclude)),
    ]
    for number, rig in enumerate(recipe.rigs):
        globs += [(("rigs", number, "match", n), glob) for n, glob in enumerate(rig.match)]
    for at, glob in globs:
        if not glob:
            yield at, "an empty glob matches nothing; `**` matches everything"
        elif glob.startswith(("/", "./")) or ".." in PurePosixPath(glob).parts:
            yield (
                at,
                f"{glob!r} cannot match: globs are matched against the path below bags.root, as in `2024/**`",
            )
    for number, rig in enumerate(recipe.rigs):
        greedy = next((other.name for other in recipe.rigs[:number] if "**" in other.match), None)
        if greedy is not None:
            yield (
                ("rigs", number, "match"),
                f"rig {rig.name} never gets a recording, because rig {greedy} before it matches `**`; put rig {greedy} last, or narrow its match",
            )


def _scenes(recipe: Recipe) -> Iterator[Problem]:
    scenes = recipe.scenes
    channels = sorted({channel for rig in recipe.rigs for channel in rig.channels})
    if scenes.reference is not None and scenes.reference not in channels:
        hint = suggestion(scenes.reference, channels) or f"; the channels are {', '.join(channels)}"
        yield ("scenes", "reference"), f"no rig has the channel {scenes.reference}{hint}"
    half_period_s = 0.5 / scenes.keyframe_hz
    if scenes.tolerance_s >= half_period_s:
        yield (
            ("scenes", "tolerance_s"),
            f"{scenes.tolerance_s:g} s must be less than half the time between keyframes ({half_period_s:g} s at {scenes.keyframe_hz:g} Hz), or one reading would belong to two keyframes",
        )
    if scenes.min_length_s > scenes.length_s:
        yield (
            ("scenes", "min_length_s"),
            f"{scenes.min_length_s:g} s is longer than a scene ({scenes.length_s:g} s), so there would be none",
        )
    if scenes.length_s < 1.0 / scenes.keyframe_hz:
        yield (
            ("scenes", "length_s"),
            f"{scenes.length_s:g} s is shorter than the time between keyframes ({1.0 / scenes.keyframe_hz:g} s)",
        )


def _repeated(names: Iterable[tuple[tuple[str | int, ...], str]]) -> Iterator[Problem]:
    """Check that no name, given with its place, is listed twice."""
    seen: set[str] = set()
    for at, name in names:
        if name in seen:
            yield at, f"{name} is listed twice"
        seen.add(name)


def _rig(rig: Rig) -> Iterator[Problem]:
    for name, channel in rig.channels.items():
        match channel:
            case CameraChannel():
                problems = _camera(channel)
            case LidarChannel():
                problems = _lidar(channel, rig)
            case RadarChannel():
                problems = _radar(channel, rig)
        for field, sentence in problems:
            yield ("channels", name, *field), sentence
    topics = ((("annotations", n, "topic"), source.topic) for n, source in enumerate(rig.annotations))
    files = ((("annotation_files", n, "path"), source.path) for n, source in enumerate(rig.annotation_files))
    yield from _repeated([*topics, *files])
    pose = rig.ego_pose
    if pose is None:
        boxes = {"annotations": rig.annotations, "annotation_files": rig.annotation_files}
        for name in (name for name, sources in boxes.items() if sources):
            yield (name,), "needs the poses of the rig, to place boxes in the world; give it an ego_pose"
    if isinstance(pose, TfSource):
        if pose.global_frame == rig.ego_frame:
            yield (
                ("ego_pose", "global_frame"),
                f"{pose.global_frame} is the ego frame itself; name the fixed frame that it moves in, such as `map`",
            )
        if not rig.tf:
            yield ("tf",), "must name a topic, because ego_pose uses tf"
    if isinstance(pose, NavSatSource) and pose.imu == pose.topic:
        yield ("ego_pose", "imu"), "is the NavSatFix topic; name a topic of sensor_msgs/Imu"


def _camera(channel: CameraChannel) -> Iterator[Problem]:
    if channel.target is not None and not channel.undistort:
        yield ("target",), "has no effect without undistortion; remove it, or set undistort: true"
    if isinstance(channel.intrinsics, Intrinsics):
        number = len(channel.intrinsics.distortion)
        lengths = _COEFFICIENTS[channel.intrinsics.model]
        if number not in lengths:
            yield (
                ("intrinsics", "distortion"),
                f"{channel.intrinsics.model} has {' or '.join(str(n) for n in lengths)} coefficients; found {number}",
            )
    if channel.to_8bit is not None and channel.output == "as_recorded" and not channel.undistort:
        yield ("to_8bit",), "contradicts `output: as_recorded`; remove one of them"


def _lidar(channel: LidarChannel, rig: Rig) -> Iterator[Problem]:
    if channel.deskew and (rig.ego_pose is None or isinstance(rig.ego_pose, FixedPose)):
        what = "there is no ego_pose" if rig.ego_pose is None else "ego_pose is fixed"
        yield ("deskew",), f"needs poses of a moving rig, but {what}; set deskew: false"
    if channel.max_range_m is not None and channel.max_range_m <= channel.min_range_m:
        yield (
            ("max_range_m",),
            f"{channel.max_range_m:g} m must be greater than min_range_m ({channel.min_range_m:g} m)",
        )


def _radar(channel: RadarChannel, rig: Rig) -> Iterator[Problem]:
    if rig.ego_pose is None and channel.velocities != "over_ground":
        yield (
            ("velocities",),
            "need the poses of the rig, unless they are over ground: give it an ego_pose, or set velocities: over_ground",
        )
