"""Rules about a finished dataset: the requirements of nuscenes-devkit, read from its source (1.2) and checked without it.

References and files are checked by `bagassets.formats.nuscenes.table_integrity`.
"""

import json
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from collections.abc import Set as AbstractSet
from pathlib import Path
from typing import NamedTuple

from bagassets.assets.quality.finding import Finding
from bagassets.formats.nuscenes.dataset_rows import DatasetRows
from bagassets.formats.nuscenes.schema import DEVKIT_SPLITS, SPLITS, Row

_FORMATS = ("jpg", "png", "pcd")
_PNG = b"\x89PNG\r\n\x1a\n"
_LIDAR_POINT_BYTES = 20
_RADAR_FIELDS = 18
# 1970-01-01 to 2100-01-01: simulators start their clocks at zero; a stamp in nanoseconds falls outside.
_MICROSECONDS = (0, 4_102_444_800_000_000)
# At this distance float32, which the devkit computes in, resolves a centimetre.
_FAR_M = 100_000.0

Tables = Mapping[str, Sequence[Row]]


def devkit_ready(rows: DatasetRows) -> Finding:
    """Check what the devkit asserts or silently relies on, and what its users take for granted."""
    problems = [*whole_problems(rows.folder, rows.tables["map"], rows.scenes), *row_problems(rows)]
    return channels_found(*held_channels(rows), len(rows.scenes), problems)


def whole_problems(folder: Path, maps: Sequence[Row], scenes: AbstractSet[str]) -> list[str]:
    """Return what is wrong with the map and the splits of a dataset, given its version folder and its scenes."""
    return [*_map(folder.parent, maps), *_splits(folder / SPLITS, scenes)]


def row_problems(rows: DatasetRows) -> Iterator[str]:
    """Yield what is wrong with rows of recordings and their files."""
    yield from _readings(rows.tables)
    yield from _point_files(rows)
    yield from _geometry(rows.tables)
    yield from _annotations(rows.tables)


class Held(NamedTuple):
    """Samples of one rig with keyframes of the same channels.

    Attributes:
        rig: the rig.
        channels: the channels, sorted.
        samples: number of samples.
        first: token of the first one.
    """

    rig: str
    channels: Sequence[str]
    samples: int
    first: str


def held_channels(rows: DatasetRows) -> tuple[list[Held], dict[str, set[str]]]:
    """Return which channels samples have, in the order of their first samples, and rig -> channels of its recordings.

    Recordings of one rig are compared, so that a camera that was off for a whole recording is noticed.
    """
    tables = rows.tables
    rig_of_log = {row["token"]: rows.rigs.get(row["logfile"], row["token"]) for row in tables["log"]}
    rig_of_scene = {row["token"]: rig_of_log.get(row["log_token"], "") for row in tables["scene"]}
    rig_of = {row["token"]: rig_of_scene.get(row["scene_token"], "") for row in tables["sample"]}
    channels = _channel_of(tables)
    of_rigs: dict[str, set[str]] = {}
    for row in tables["sample_data"]:
        rig = rig_of.get(row["sample_token"], "")
        of_rigs.setdefault(rig, set()).add(channels.get(row["calibrated_sensor_token"], ""))
    alike: dict[tuple[str, tuple[str, ...]], list[str]] = {}
    for token, held in _channels_of_samples(tables).items():
        alike.setdefault((rig_of[token], tuple(sorted(held))), []).append(token)
    return [Held(rig, held, len(tokens), tokens[0]) for (rig, held), tokens in alike.items()], of_rigs


def channels_found(
    held: Sequence[Held], of_rigs: Mapping[str, AbstractSet[str]], scenes: int, problems: Sequence[str]
) -> Finding:
    """Return what is to be said of channels, and of problems.

    Args:
        held: see `held_channels`.
        of_rigs: see `held_channels`.
        scenes: number of scenes.
        problems: what else is wrong.
    """
    lacking = [(one, sorted(of_rigs.get(one.rig, frozenset()) - {*one.channels})) for one in held]
    lacking = [(one, names) for one, names in lacking if names]
    facts = {
        "scenes": scenes,
        # The devkit's evaluation and renderers name this channel.
        "samples_without_LIDAR_TOP": sum(one.samples for one in held if "LIDAR_TOP" not in one.channels),
        "samples_lacking_a_channel": sum(one.samples for one, _ in lacking),
    }
    return Finding(problems, facts, _lacking_sentences(lacking, sum(one.samples for one in held)))


def _channels_of_samples(tables: Tables) -> dict[str, set[str]]:
    """Return sample token -> channels with a keyframe in it, in the order of the table."""
    channels = _channel_of(tables)
    held: dict[str, set[str]] = {row["token"]: set() for row in tables["sample"]}
    for row in tables["sample_data"]:
        if row["is_key_frame"] is True and row["sample_token"] in held:
            held[row["sample_token"]].add(channels.get(row["calibrated_sensor_token"], ""))
    return held


def _channel_of(tables: Tables) -> dict[str, str]:
    """Return calibrated_sensor token -> channel."""
    names = {row["token"]: str(row["channel"]) for row in tables["sensor"]}
    return {row["token"]: names.get(row["sensor_token"], "") for row in tables["calibrated_sensor"]}


def _lacking_sentences(lacking: Sequence[tuple[Held, Sequence[str]]], samples: int) -> list[str]:
    if not lacking:
        return []
    counts: Counter[str] = Counter()
    for one, names in lacking:
        counts.update(dict.fromkeys(names, one.samples))
    number = sum(one.samples for one, _ in lacking)
    by_channel = ", ".join(f"{name} in {times}" for name, times in counts.most_common())
    sentence = (
        f"{number} of {samples} samples {'lacks' if number == 1 else 'lack'} a channel that other samples of "
        f"the same rig have, and code that expects every channel in each sample fails on them: {by_channel}; the first is sample "
        f"{lacking[0][0].first}. `missing: refuse` under "
        "scenes, the default, drops single samples; recordings without the channel are left out by rigs[].required"
    )
    return [sentence]


def _first(what: str, offenders: Sequence[str]) -> Iterator[str]:
    if offenders:
        rows = "1 row" if len(offenders) == 1 else f"{len(offenders)} rows, the first is"
        yield f"{what}: {rows} {offenders[0]}"


def _map(dataroot: Path, maps: Sequence[Row]) -> Iterator[str]:
    if not maps:
        yield "map: has no row, but the devkit opens a map for every log"
    for row in maps:
        path = dataroot / row["filename"]
        try:
            with path.open("rb") as stream:
                head = stream.read(len(_PNG))
        except OSError as err:
            yield f"map {row['token']}: {path} cannot be read ({err.strerror})"
            continue
        if head != _PNG:
            yield f"map {row['token']}: {path} is not a PNG file"


def _readings(tables: Tables) -> Iterator[str]:
    data = tables["sample_data"]
    yield from _first(
        "sample_data.fileformat is not jpg, png or pcd",
        [f"{row['token']} ({row['fileformat']})" for row in data if row["fileformat"] not in _FORMATS],
    )
    yield from _first(
        "sample_data.filename does not end as the devkit's readers expect",
        [str(row["filename"]) for row in data if not _ends_well(row)],
    )
    for name in ("sample", "sample_data", "ego_pose"):
        low, high = _MICROSECONDS
        yield from _first(
            f"{name}.timestamp is not an integer in microseconds from 1970 to 2100",
            [
                f"{row['token']} ({row['timestamp']})"
                for row in tables[name]
                if type(row["timestamp"]) is not int or not low <= row["timestamp"] < high
            ],
        )
    yield from _first(
        "sample_data of a camera without width and height",
        [
            str(row["token"])
            for row in data
            if row["fileformat"] != "pcd" and not (row["width"] > 0 and row["height"] > 0)
        ],
    )


def _ends_well(row: Row) -> bool:
    ends = (".pcd", ".pcd.bin") if row["fileformat"] == "pcd" else f".{row['fileformat']}"
    return str(row["filename"]).endswith(ends)


def _point_files(rows: DatasetRows) -> Iterator[str]:
    """Check sizes of lidar files and the headers of one radar file per channel."""
    odd = []
    radars: dict[str, str] = {}
    for row in rows.tables["sample_data"]:
        name = str(row["filename"])
        if name.endswith(".pcd.bin"):
            # One that is missing is reported elsewhere.
            if rows.sizes.get(name, 0) % _LIDAR_POINT_BYTES:
                odd.append(f"{row['token']} ({name})")
        elif name.endswith(".pcd"):
            radars.setdefault(str(row["calibrated_sensor_token"]), name)
    yield from _first(
        f"sample_data: lidar file does not hold points of 5 float32 ({_LIDAR_POINT_BYTES} bytes)", odd
    )
    for name in sorted(radars.values()):
        problem = _radar_problem(rows.dataroot / name)
        if problem is not None:
            yield f"{name}: {problem}"


def _radar_problem(path: Path) -> str | None:
    """Return why `RadarPointCloud.from_file` would refuse a file, or None; missing files are reported elsewhere."""
    try:
        content = path.read_bytes()
    except OSError:
        return None
    header, separator, _ = content.partition(b"DATA binary\n")
    lines = dict(line.split(" ", 1) for line in header.decode("ascii", "replace").splitlines() if " " in line)
    if not separator:
        return "is not a binary PCD file"
    fields = lines.get("FIELDS", "").split()
    if len(fields) != _RADAR_FIELDS:
        return f"has {len(fields)} fields, the devkit reads {_RADAR_FIELDS}"
    if lines.get("WIDTH", "0") == "0":
        return "has no points at all, which the devkit asserts against"
    sizes = [int(size) for size in lines["SIZE"].split()]
    needed = len(header) + len(separator) + int(lines["WIDTH"]) * sum(sizes)
    if len(content) <= needed:
        return f"has {len(content)} bytes, the devkit's reader requires more than {needed}"
    return None


def _annotations(tables: Tables) -> Iterator[str]:
    rows = tables["sample_annotation"]
    yield from _first(
        "sample_annotation with more than one attribute, which DetectionEval refuses",
        [str(row["token"]) for row in rows if len(row["attribute_tokens"]) > 1],
    )
    yield from _first(
        "sample_annotation.size is not positive",
        [str(row["token"]) for row in rows if not min(row["size"]) > 0],
    )


def _geometry(tables: Tables) -> Iterator[str]:
    for name in ("ego_pose", "calibrated_sensor", "sample_annotation"):
        yield from _first(
            f"{name}.rotation is not a unit quaternion w, x, y, z",
            [str(row["token"]) for row in tables[name] if not _is_unit(row["rotation"])],
        )
    cameras = {row["token"] for row in tables["sensor"] if row["modality"] == "camera"}
    wrong = [
        str(row["token"])
        for row in tables["calibrated_sensor"]
        if (k := row["camera_intrinsic"])
        and not (row["sensor_token"] in cameras and len(k) == len(k[0]) == 3)
    ]
    yield from _first("calibrated_sensor.camera_intrinsic is not 3x3 for cameras and empty for others", wrong)
    far = [
        f"{row['token']} ({max(abs(v) for v in row['translation']):.0f} m)"
        for row in tables["ego_pose"]
        if max(abs(value) for value in row["translation"][:2]) > _FAR_M
    ]
    yield from _first("ego_pose is too far from the origin for the devkit's float32", far)


def _is_unit(rotation: Sequence[float]) -> bool:
    return len(rotation) == 4 and abs(sum(value * value for value in rotation) - 1.0) < 1e-5


def _splits(path: Path, scenes: AbstractSet[str]) -> Iterator[str]:
    try:
        splits: Mapping[str, Sequence[str]] = json.loads(path.read_bytes())
    except (OSError, ValueError) as err:
        yield f"{path}: cannot be read ({err})"
        return
    seen: dict[str, str] = {}
    for split, names in sorted(splits.items()):
        if split in DEVKIT_SPLITS:
            yield f"{path.name}: the devkit answers split {split} with the scenes of nuScenes; give it another name"
        for name in names:
            if name not in scenes:
                yield f"{path.name}: split {split} names scene {name}, which does not exist"
                return
            other = seen.setdefault(name, split)
            if other != split:
                yield f"{path.name}: scene {name} is in the splits {other} and {split}"
                return
