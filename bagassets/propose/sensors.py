"""Which topics of a recording are sensors worth extracting, one topic per sensor."""

from dataclasses import dataclass

from bagassets.decode.hesai import corrections_beside
from bagassets.decode.ouster import metadata_beside
from bagassets.decode.registry import AnyFamily, families_of, own_types
from bagassets.propose.naming import (
    Modality,
    is_derived,
    is_of_radar,
    is_radar_list,
    is_sensor_type,
    sensor_of,
    tokens,
)
from bagassets.propose.summary import RecordingSummary, TopicSummary, TopicUse
from bagassets.recordings.topic import UNKNOWN

_BY_FAMILY: dict[AnyFamily, Modality] = {
    "image": "camera",
    "video": "camera",
    "cloud": "lidar",
    "ouster": "lidar",
    "radar": "radar",
}
# Carries packets of Velodyne lidars only; other types may carry any packets.
_VELODYNE_SCAN = "velodyne_msgs/msg/VelodyneScan"
# Its driver publishes other packets than those of points with the same type.
_OUSTER_OTHERS = frozenset({"imu", "zone", "telemetry"})
_DEPTH_WORDS = frozenset({"depth", "disparity", "registered"})
# Depth as well, if of 16 bit; `/stereo/image_raw` of an OAK is.
_DEPTH_WORDS_16UC1 = frozenset({"stereo", "tof"})
# Topics of one sensor whose counts differ by less are complete alike: the bag began between two messages.
_SIMILAR_COUNT = 0.9


@dataclass(frozen=True)
class Sensor:
    """One sensor and the topic proposed for it.

    Attributes:
        modality: kind of sensor.
        topic: the topic to extract.
        others: topics that carry the same sensor's data in another form.
        camera_info: the CameraInfo topic of a camera; None if there is none.
    """

    modality: Modality
    topic: TopicSummary
    others: tuple[str, ...] = ()
    camera_info: TopicSummary | None = None


def modality_of(topic: TopicSummary) -> Modality | None:
    """Return the kind of sensor that a topic belongs to by type and name; None if to none."""
    if has_ouster_packets(topic) and not _OUSTER_OTHERS.isdisjoint(tokens(topic.name)):
        return None
    modalities = {_BY_FAMILY[family] for family in families_of(topic.msgtype) if family in _BY_FAMILY}
    if "lidar" in modalities and topic.msgtype in own_types("radar"):
        return "radar" if topic.is_of_radar or is_of_radar(topic.name, *topic.frames) else "lidar"
    if modalities:
        return min(modalities)
    if topic.packets_of or topic.msgtype == _VELODYNE_SCAN:
        return "lidar"
    return "radar" if is_radar_list(topic.msgtype) else None


def find_sensors(summary: RecordingSummary) -> tuple[list[Sensor], list[TopicUse]]:
    """Return the sensors of a recording, in order of kind and topic, and what is left out, in order of topic."""
    left_out: list[TopicUse] = []
    families: list[list[TopicSummary]] = []
    tracked = {frame for topic in summary.topics.values() for frame in topic.child_frames}
    fixed = {frame for topic in summary.topics.values() if topic.child_frames for frame in topic.frames}
    for topic in summary.topics.values():
        if (unusable := _unusable(topic)) is not None:
            left_out.append(unusable)
        elif modality_of(topic) == "lidar" and topic.frames and (fixed - tracked).issuperset(topic.frames):
            why = f"computed: its points are in {topic.frames[0]}, in which the robot moves"
            left_out.append(TopicUse(topic, "left out", why))
        elif modality_of(topic) is not None:
            family = next((known for known in families if same_sensor(known[0], topic)), [])
            if not family:
                families.append(family)
            family.append(topic)
    sensors = [_sensor(family, summary) for family in families]
    left_out += [
        TopicUse(summary.topics[other], "left out", f"the same sensor as {sensor.topic.name}")
        for sensor in sensors
        for other in sensor.others
    ]
    sensors.sort(key=lambda sensor: (sensor.modality, _lidar_rank(sensor), sensor.topic.name))
    return sensors, sorted(left_out, key=lambda left: left.topic.name)


def has_ouster_packets(topic: TopicSummary) -> bool:
    """Tell whether messages hold packets of an Ouster, which have neither stamp nor frame."""
    return topic.msgtype in own_types("ouster")


def needs_metadata(topic: TopicSummary) -> bool:
    """Tell whether packets say nothing without metadata of the lidar that sent them."""
    return has_ouster_packets(topic) or topic.packets_of == "Hesai"


def metadata_of(topic: TopicSummary, summary: RecordingSummary) -> str | None:
    """Return the topic with the metadata of the lidar whose packets a topic holds; None if there is none.

    A Hesai's do not count beside the packets of two: they are of one of them, and nothing says of which.
    """
    place = corrections_beside if topic.packets_of else metadata_beside
    beside = summary.topics.get(place(topic.name))
    hesais = [
        one
        for one in summary.topics.values()
        if one.packets_of == topic.packets_of == "Hesai" and place(one.name) == place(topic.name)
    ]
    return beside.name if beside and beside.count and needs_metadata(topic) and len(hesais) < 2 else None


def lacks_definition(topic: TopicSummary) -> bool:
    """Tell whether a sensor's messages would be decoded if their type were defined."""
    return topic.problem is not None and "definition" in topic.problem and modality_of(topic) is not None


def shown_type(msgtype: str) -> str:
    """Return a message type as people write it."""
    return msgtype.replace("/msg/", "/")


def _unusable(topic: TopicSummary) -> TopicUse | None:
    """Return why no sensor is proposed for a topic, though its type would do.

    None if one is proposed, or if its type is not that of a sensor.
    """
    modality = modality_of(topic)
    if modality is None:
        if topic.count > 0 and topic.msgtype == UNKNOWN:
            return TopicUse(topic, "not decodable", "no schema says what its messages are; record one")
        if topic.count > 0 and not families_of(topic.msgtype) and is_sensor_type(topic.msgtype):
            what = shown_type(topic.msgtype)
            if topic.packets_of is not None:
                what = "its packets, which are of no Velodyne, nor of a Hesai of a known model"
            return TopicUse(
                topic,
                "not decodable",
                f"no decoder for {what}; record what its driver publishes (Image, PointCloud2), or "
                "install a decoder (`bagassets docs page decoders`)",
            )
        return None
    if topic.count == 0:
        return TopicUse(topic, "left out", "no messages")
    if topic.problem is not None:
        return TopicUse(topic, "not decodable", topic.problem)
    words = _DEPTH_WORDS | _DEPTH_WORDS_16UC1 if topic.encoding == "16uc1" else _DEPTH_WORDS
    if not words.isdisjoint(tokens(topic.name)) or topic.encoding == "32fc1":  # REP 118
        depth = (
            "depth, not a picture; a channel of depth needs `output: png` and `undistort: false`"
            if modality == "camera"
            else "the cloud of a depth camera"
        )
        return TopicUse(topic, "left out", depth)
    if topic.packets_of == "":
        return TopicUse(topic, "not decodable", "none of its packets is from a Velodyne")
    if topic.refusal is not None:
        return TopicUse(topic, "not decodable", topic.refusal)
    if is_derived(topic.name):
        return TopicUse(topic, "left out", "looks computed, not recorded by a sensor")
    return None


def same_sensor(one: TopicSummary, other: TopicSummary) -> bool:
    """Tell whether two topics, of one recording or of two, are what one sensor measured."""
    if modality_of(one) != modality_of(other) or _is_flat(one) != _is_flat(other):
        return False
    # Drivers give all cameras one frame surprisingly often, so pictures go by the name of their topic.
    if modality_of(one) != "camera" and one.frames and other.frames:
        return not set(one.frames).isdisjoint(other.frames)
    names = sorted((sensor_of(one.name), sensor_of(other.name)))
    # ZED's driver publishes its left camera as that of the whole, too: `rgb`, which is no part of a sensor's name.
    is_left = names[1] == f"{names[0]}/left" and not set(one.frames).isdisjoint(other.frames)
    is_left &= "rgb" in f"{one.name}{other.name}"
    return names[0] == names[1] or is_left


def _sensor(family: list[TopicSummary], summary: RecordingSummary) -> Sensor:
    """Choose among topics of one sensor: the one with more messages, then the rawest; clouds before packets that need metadata."""
    measured = [topic for topic in family if not needs_metadata(topic)] or family
    most = max(topic.count for topic in measured)
    complete = [topic for topic in measured if topic.count >= _SIMILAR_COUNT * most]
    chosen = min(complete, key=lambda topic: (_processing(topic), -topic.count, topic.name))
    others = tuple(sorted(topic.name for topic in family if topic is not chosen))
    modality = modality_of(chosen) or "camera"
    info = _camera_info(chosen, summary) if modality == "camera" else None
    return Sensor(modality, chosen, others, info)


def _processing(topic: TopicSummary) -> int:
    """Return how far a topic is from what the sensor measured; less is rawer."""
    words = set(tokens(topic.name))
    steps = (
        (1, not topic.packets_of and modality_of(topic) == "lidar"),
        (1, topic.msgtype.endswith(("/CompressedImage", "sensor_msgs/msg/PointCloud"))),
        (2, topic.is_video),
        (4, words & {"rect", "rectified", "undistorted"}),
        (2, words & {"mono", "grey", "gray"}),  # the colour of the same camera says more
        (2, words & {"track", "tracks", "object", "objects"}),
    )
    return sum(number for number, applies in steps if applies)


def _is_flat(topic: TopicSummary) -> bool:
    return topic.msgtype.endswith("LaserScan")


def _lidar_rank(sensor: Sensor) -> int:
    """Put the lidar that deserves to be LIDAR_TOP first: on top, then three-dimensional."""
    words = {*tokens(sensor.topic.name), *tokens(" ".join(sensor.topic.frames))}
    if sensor.modality != "lidar":
        return 0
    is_main = words & {"top", "roof", "center", "main", "concatenated"}
    return (2 if _is_flat(sensor.topic) else 0) + (0 if is_main else 1)


def _camera_info(image: TopicSummary, summary: RecordingSummary) -> TopicSummary | None:
    infos = {
        topic.name: topic
        for topic in summary.topics.values()
        if topic.msgtype in own_types("camera_info") and topic.count > 0
    }
    parts, length = image.name.split("/"), len(sensor_of(image.name).split("/"))
    for stop in range(len(parts), length - 1, -1):  # the nearest first
        beside = "/".join([*parts[:stop], "camera_info"])
        if beside in infos:
            return infos[beside]
    matching = [info for info in infos.values() if not set(info.frames).isdisjoint(image.frames)]
    return matching[0] if len(matching) == 1 else None
