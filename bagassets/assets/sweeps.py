"""The asset `sweeps`: the revolutions of each lidar and the scans of each radar, with an index.

Files of one sensor: `<stamp_ns>.pcd.bin` or `<stamp_ns>.pcd`, `index.parquet`, `channel.json`.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Literal

from bagassets.assets.asset import Asset, Facts, Inputs, Use, omitted, uses_of
from bagassets.assets.calibration import CALIBRATION
from bagassets.assets.channel import channel_face, require_decoder, settings_of
from bagassets.assets.ego_poses import EGO_POSES
from bagassets.assets.inventory import INVENTORY
from bagassets.assets.lidar_sweeps import (
    NO_STAMP,
    CloudSweeps,
    CloudUse,
    LidarSettings,
    LidarUse,
    LidarWriter,
)
from bagassets.assets.ouster_sweeps import OusterSweeps, OusterUse, lidar_of
from bagassets.assets.packet_sweeps import PacketSweeps, PacketUse
from bagassets.assets.quality.channel_rules import channels_complete
from bagassets.assets.quality.check import RecordingCheck
from bagassets.assets.radar_sweeps import RadarSettings, RadarSweeps, RadarUse
from bagassets.assets.sweep_files import LIDAR_SCHEMA, SweepFiles
from bagassets.base.errors import DecodeError, LossLimitError, RecipeError
from bagassets.base.json_types import JsonObject
from bagassets.decode.fields import check_points, head
from bagassets.decode.hesai import corrections_beside
from bagassets.decode.ouster import metadata_beside
from bagassets.decode.point_times import Moment
from bagassets.decode.pointcloud2 import POINT_CLOUDS
from bagassets.decode.radar import measures_relative
from bagassets.recipe.model import LidarChannel, PointTimes, RadarChannel, Recipe, Rig
from bagassets.recordings.inventory import Inventory
from bagassets.recordings.model import Message, RawMessage
from bagassets.recordings.recording import Recording
from bagassets.store.artifact import ArtifactWriter
from bagassets.store.canonical import digest_bytes

SweepUse = CloudUse | PacketUse | OusterUse | RadarUse
# Field of a lidar -> the families of decoders for which it means something, and what they read.
_MEANT_FOR = {
    "header_stamp_is": ({"cloud"}, "clouds"),
    "zero_points": ({"cloud"}, "clouds"),
    "model": ({"packets"}, "Velodyne packets"),
    "cut_angle_deg": ({"packets", "ouster"}, "packets"),
    "metadata": ({"ouster", "packets"}, "packets of Ouster and Hesai"),
}


@dataclass(frozen=True, kw_only=True)
class LidarChannelSettings:
    """Settings of a lidar in the recipe, for clouds and packets.

    Attributes:
        common: settings for both.
        header_stamp_is: for clouds, which time of a revolution their stamps are.
        model: for packets, the model of the lidar.
        cut_angle_deg: for packets, azimuth at which revolutions begin.
        metadata: for packets of an Ouster or Hesai, the file with its metadata or corrections; None if the recording has it.
        zero_points: for clouds, what becomes of points at exactly 0, 0, 0.
        point_times: for clouds, what the times of their points are.
    """

    common: LidarSettings
    header_stamp_is: Moment | None
    model: str | None
    cut_angle_deg: float | None
    zero_points: Literal["drop", "keep"]
    point_times: PointTimes | Literal["ignore"] | None = omitted()
    metadata: Path | None = omitted()


@dataclass(frozen=True)
class SweepsParams:
    """Parameters of `sweeps`.

    Attributes:
        lidars: channel -> its settings.
        radars: channel -> its settings.
    """

    lidars: Mapping[str, LidarChannelSettings]
    radars: Mapping[str, RadarSettings]

    @classmethod
    def of(cls, recipe: Recipe, rig: Rig) -> "SweepsParams":
        """Return the parameters of a rig."""
        lidars, radars = {}, {}
        for name, channel in sorted(rig.channels.items()):
            given = {**dict(recipe.limits), **dict(channel), "clock": recipe.clock_of(rig, channel)}
            if isinstance(channel, LidarChannel):
                given["common"] = settings_of(LidarSettings, given)
                lidars[name] = settings_of(LidarChannelSettings, given)
            elif isinstance(channel, RadarChannel):
                radars[name] = settings_of(RadarSettings, given)
        return cls(lidars, radars)


def use(params: SweepsParams, facts: Facts) -> dict[str, Use[SweepUse] | Exception]:
    """Return what the sweeps of each lidar and radar in a recording depend on."""
    has = facts.inventory.has_readable
    lidars = {name: settings for name, settings in params.lidars.items() if has(settings.common.topic)}
    radars = {name: settings for name, settings in params.radars.items() if has(settings.topic)}
    uses = uses_of(lidars, partial(_use_of_lidar, facts)) | uses_of(radars, partial(_use_of_radar, facts))
    return dict(sorted(uses.items()))


def _use_of_lidar(facts: Facts, name: str, settings: LidarChannelSettings) -> Use[SweepUse]:
    """Return what the sweeps of one lidar depend on.

    From upstream, that is its message type. Extrinsics and ego poses count only with deskewing; without it,
    changing them makes no sweeps stale.

    Raises:
        RecipeError: the recipe has settings for messages of another type than the topic carries.
        DecodeError: the topic carries something else.
        PluginError: several decoder plug-ins claim the type of its messages.
    """
    common = settings.common
    topic = facts.inventory.topic(common.topic)
    decoder = require_decoder(name, topic.name, topic.msgtype, "cloud", "ouster", "packets")
    if settings.point_times is not None and topic.msgtype not in POINT_CLOUDS:
        raise RecipeError(
            f"{name}: point_times can be set for PointCloud2 only, but {topic.name} carries {topic.msgtype}; remove it "
            "from the recipe."
        )
    mount = facts.calibration.channels[name].ego_SE3_sensor if common.deskew else None
    inputs = {EGO_POSES.name: facts.artifact(EGO_POSES.name).digest} if common.deskew else {}
    lidar = LidarUse(
        channel=name, settings=common, msgtype=topic.msgtype, decoder=decoder.key, ego_SE3_sensor=mount
    )
    for field, (families, read) in _MEANT_FOR.items():
        is_set = getattr(settings, field) != LidarChannel.model_fields[field].default
        if is_set and decoder.family not in families:
            raise RecipeError(
                f"{name}: {field} can be set for {read} only, but {topic.name} carries {topic.msgtype}; remove it from the "
                "recipe."
            )
    if decoder.family != "cloud":
        cut_deg = settings.cut_angle_deg
        packets = (
            OusterUse(**vars(lidar), cut_angle_deg=cut_deg, metadata_topic=None)
            if decoder.family == "ouster"
            else PacketUse(**vars(lidar), model=settings.model, cut_angle_deg=cut_deg)
        )
        return _use_of_packets(facts, packets, settings.metadata, inputs)
    clouds = CloudUse(
        **vars(lidar),
        header_stamp_is=settings.header_stamp_is,
        # The length of a revolution is only needed with `header_stamp_is`.
        period_ns=None if settings.header_stamp_is is None else topic.period_ns,
        zero_points=settings.zero_points,
        point_times=settings.point_times,
    )
    return Use(clouds, (topic.name,), inputs)


def _use_of_packets(
    facts: Facts, use: PacketUse | OusterUse, file: Path | None, inputs: Mapping[str, str]
) -> Use[SweepUse]:
    """Return what the sweeps of a lidar depend on whose packets were recorded: what its unit says of itself, too.

    That is an Ouster's metadata or a Hesai's corrections, in a file or on a topic beside the packets. Only the packets say
    whether they are of a Hesai, which cannot be used without.

    Raises:
        RecipeError: it is an Ouster without metadata, or the file with it cannot be read.
    """
    topic = use.settings.topic
    if file is not None:
        content = _metadata(facts, use.channel, file)
        return Use(replace(use, metadata=content), (topic,), {**inputs, "metadata": digest_bytes(content)})
    is_ouster = isinstance(use, OusterUse)
    beside = metadata_beside(topic) if is_ouster else corrections_beside(topic)
    if facts.inventory.has_readable(beside):
        return Use(replace(use, metadata_topic=beside), (topic, beside), inputs)
    if is_ouster:
        raise RecipeError(
            f"{use.channel}: the packets in {topic} say nothing without the metadata of the lidar, and the recording has no "
            f"{beside}; name a file with it in `metadata` of the channel."
        )
    return Use(use, (topic,), inputs)


def _metadata(facts: Facts, channel: str, path: Path) -> bytes:
    try:
        return facts.file(path)
    except OSError as err:
        raise RecipeError(
            f"{channel}: {path}: the metadata cannot be read ({err.strerror}); correct `metadata` in the recipe."
        ) from err


def _use_of_radar(facts: Facts, name: str, settings: RadarSettings) -> Use[SweepUse]:
    """Return what the sweeps of one radar depend on.

    From upstream, that is its message type. Extrinsics and ego poses count only if they compensate its velocities.

    Raises:
        RecipeError: the recipe has `azimuth_positive`, but a plug-in decodes the messages.
        DecodeError: the topic carries something else.
        PluginError: several decoder plug-ins claim the type of its messages.
    """
    msgtype = facts.inventory.topic(settings.topic).msgtype
    decoder = require_decoder(name, settings.topic, msgtype, "radar")
    if decoder.plugin is not None and settings.azimuth_positive is not None:
        raise RecipeError(
            f"{name}: azimuth_positive has no effect on {settings.topic}, whose {msgtype} a plug-in of "
            f"{decoder.plugin.distribution} decodes; remove it from the recipe."
        )
    relative = _is_relative(settings, None if decoder.plugin else msgtype)
    mount = facts.calibration.channels[name].ego_SE3_sensor if relative else None
    inputs = {EGO_POSES.name: facts.artifact(EGO_POSES.name).digest} if relative else {}
    use = RadarUse(
        channel=name, settings=settings, msgtype=msgtype, decoder=decoder.key, ego_SE3_sensor=mount
    )
    return Use(use, (settings.topic,), inputs)


def _is_relative(settings: RadarSettings, msgtype: str | None) -> bool:
    """Tell whether the velocities of a radar are relative to it, by the recipe or else by the type of its messages.

    The type is None where a plug-in gives its own meaning to it.
    """
    if settings.velocities is None:
        return msgtype is not None and measures_relative(msgtype)
    return settings.velocities == "relative"


class SweepExtractor:
    """Turns the messages of one lidar or radar channel into the files of an artifact.

    Args:
        use: everything that shapes the files.
        recording: decodes the messages.
        out: writes the artifact.
        inputs: give the ego poses, which are read only if the channel is corrected for its motion.
    """

    def __init__(self, use: SweepUse, recording: Recording, out: ArtifactWriter, inputs: Inputs) -> None:
        self.topics: tuple[str, ...] = (use.settings.topic,)
        self._use = use
        self._recording = recording
        self._messages = 0
        self._failed_messages = 0
        self._failed_parts = 0
        self._first_error: str | None = None
        self._frame_id: str | None = None
        # Plug-ins decide themselves about messages without a header or stamp.
        self._needs_header = use.decoder is None and not isinstance(use, PacketUse | OusterUse)
        is_lidar = not isinstance(use, RadarUse)
        self._files = SweepFiles(out, ".pcd.bin" if is_lidar else ".pcd", with_span=is_lidar)
        mount = use.ego_SE3_sensor
        motion = None if mount is None else (inputs.trajectory, mount.normalised())
        self._sweeps: CloudSweeps | PacketSweeps | OusterSweeps | RadarSweeps
        match use:
            case RadarUse():
                self._sweeps = RadarSweeps(use, self._files, motion)
            case PacketUse():
                writer = LidarWriter(use, self._files, motion)
                topic = recording.topics[use.settings.topic]
                self._sweeps = PacketSweeps(use, writer, topic, inputs, self._decoded, self._fail_parts)
            case OusterUse():
                writer = LidarWriter(use, self._files, motion)
                lidar = lidar_of(use, inputs)
                self._sweeps = OusterSweeps(use, lidar, writer, self._decoded, self._fail_parts)
            case CloudUse():
                self._sweeps = CloudSweeps(use, LidarWriter(use, self._files, motion), self._fail_parts)

    def add(self, message: RawMessage) -> None:
        """Take the next message; one that cannot be decoded is counted as lost."""
        self._messages += 1
        if isinstance(self._sweeps, PacketSweeps | OusterSweeps):
            self._sweeps.add(message)
            return
        try:
            frame_id = self._sweeps.add(self._decoded(message), message)
            self._frame_id = self._frame_id or frame_id
        except DecodeError as err:
            self._files.counts.read += 1
            self._fail_parts(str(err), 1, 1)

    def finish(self) -> JsonObject:
        """Write pending readings and the index; return the summary.

        Raises:
            LossLimitError: more was lost than the recipe allows, or the counts do not add up.
        """
        self._sweeps.finish()
        if isinstance(self._sweeps, PacketSweeps):
            self._frame_id = self._sweeps.frame_id
        use, files = self._use, self._files
        counts, points = files.counts, files.points
        where = f"{use.channel}: topic {use.settings.topic}"
        shares = (
            (self._failed_messages, self._messages, "messages"),
            (self._failed_parts, counts.read, "packets"),
        )
        for failed, read, unit in shares:
            if failed > use.settings.lost_messages * read:
                raise LossLimitError(
                    f"{where} lost {failed} of {read} {unit}; the first: {self._first_error}. "
                    "If that is acceptable, raise limits.lost_messages in the recipe; else remove the channel "
                    "or repair the recording."
                )
        if not (counts.balanced and points.balanced):
            raise LossLimitError(
                f"{where}: counts do not add up, {counts.as_json()}, points {points.as_json()}; "
                "this is a bug of the step, please report it."
            )
        facts = {"counts": counts.as_json(), "messages": self._messages, "points": points.as_json()}
        files.finish(
            {
                "channel": use.channel,
                "modality": use.modality,
                "topic": use.settings.topic,
                "frame_id": self._frame_id or "",
                "fileformat": "pcd",
                "camera_intrinsic": [],
                **facts,
            }
        )
        return {**facts, "bytes": files.bytes}

    def _decoded(self, message: RawMessage) -> Message:
        decoded = self._recording.decode(message)
        settings = self._use.settings
        check_points(decoded, settings.cloud_points)
        if self._needs_header:
            stamp_ns, _ = head(decoded)
            # Simulated time may start at 0, but does not stay there.
            if settings.clock == "header" and self._messages > 1 and not stamp_ns:
                raise DecodeError(NO_STAMP)
        return decoded

    def _fail_parts(self, reason: str, number: int, messages: int) -> None:
        self._failed_parts += number
        self._failed_messages += messages
        self._first_error = self._first_error or reason
        self._files.lose(reason, number)


def _waits_for(params: SweepsParams, inventory: Inventory | None) -> frozenset[str]:
    always = frozenset({INVENTORY.name, CALIBRATION.name})
    deskews = any(lidar.common.deskew for lidar in params.lidars.values())
    topics = {} if inventory is None else inventory.topics
    compensates = any(
        _is_relative(radar, topics[radar.topic].msgtype)
        for radar in params.radars.values()
        if radar.topic in topics
    )
    return always | {EGO_POSES.name} if deskews or compensates else always


SWEEPS = Asset(
    name="sweeps",
    version=4,
    changes={4: "drops points at exactly 0, 0, 0, and decides for a whole topic what times of points mean"},
    # Of 4 are times of points that are decided per topic, and points at the origin that are left out.
    spared={4: lambda use: not isinstance(use, CloudUse)},
    libraries=("pyarrow", "velodyne-decoder"),
    title="The lidar revolutions and radar scans as files of points, indexed by stamp.",
    description="""One artifact per sensor: `.pcd.bin` for lidar, deskewed if the recipe says so, and `.pcd` for radar, with velocities
compensated for ego motion if they are relative.""",
    kinds=frozenset({"pointcloud", "parquet"}),
    face=channel_face("sweeps", LIDAR_SCHEMA),
    reads=(INVENTORY, CALIBRATION, EGO_POSES),
    waits_for=_waits_for,
    families=("cloud", "radar"),
    params=SweepsParams.of,
    use=use,
    extract=lambda use, inputs, recording, out, _: SweepExtractor(use.params, recording, out, inputs),
    checks=(
        RecordingCheck(
            "sweeps_complete",
            "channels_present",
            "Every message read was written, merged or counted as lost, and every lidar and radar has files.",
            "as `frames_complete`, of lidars and radars",
            lambda e: channels_complete(e.channels("sweeps"), e.max_lost, e.clock_of),
            quick=True,
        ),
    ),
)
