"""The step `sweeps`: one lidar or radar channel of a recording becomes files and an index.

Files: `<stamp_ns>.pcd.bin` or `<stamp_ns>.pcd`, `index.parquet`, `channel.json`.
"""

from collections.abc import Mapping
from typing import Any, Literal

from bagassets.bags.inventory import Inventory
from bagassets.bags.model import RawMessage, Recording
from bagassets.decode.clouds import CLOUD_DECODERS, check_points
from bagassets.decode.fields import stamp_ns
from bagassets.decode.packets import PAYLOADS
from bagassets.errors import CalibrationError, DecodeError, LossLimitError, PoseError, RecipeError
from bagassets.geometry.tf_tree import normalise_frame
from bagassets.geometry.trajectory import Trajectory
from bagassets.recipe.model import LidarChannel, Limits, RadarChannel
from bagassets.recipe.model_base import Clock
from bagassets.steps.channel import Request
from bagassets.steps.lidar_sweeps import NO_STAMP, CloudSweeps, LidarWriter, PacketSweeps
from bagassets.steps.radar_sweeps import RadarSweeps
from bagassets.steps.sweep_files import SweepFiles
from bagassets.steps.topic_types import require_type
from bagassets.store.action import Step
from bagassets.store.artifact import ArtifactWriter

__all__ = ["STEP", "SweepExtractor", "request"]

STEP = Step("sweeps", 3, ("pyarrow", "velodyne-decoder"))


def request(
    name: str,
    channel: LidarChannel | RadarChannel,
    clock: Clock,
    limits: Limits,
    inventory: Inventory,
    *,
    ego_SE3_sensor: Mapping[str, Any] | None,
    ego_poses_digest: str | None,
) -> Request:
    """Return what the step reads of this recording.

    Extrinsics and ego poses enter only if the channel is deskewed; without, no change of them
    makes the sweeps stale.

    Args:
        name: canonical channel.
        channel: its part of the recipe.
        clock: which time of a message counts.
        limits: accepted losses and sizes.
        inventory: what is in the recording.
        ego_SE3_sensor: `translation` and `rotation` as in `calibration.json`; None if not known.
        ego_poses_digest: content digest of the ego poses; None if not known.

    Raises:
        RecipeError: the recipe says something about packets, but the topic carries clouds; or about
            azimuths, but a plug-in decodes them.
        DecodeError: the topic carries something else.
        PluginError: several decoder plug-ins claim its type.
        CalibrationError: the channel is to be deskewed, but its extrinsics are not known.
        PoseError: the channel is to be deskewed, but there are no ego poses.
    """
    topic = inventory.topic(channel.topic)
    params: dict[str, Any] = {
        "channel": name,
        "modality": channel.modality,
        "topic": channel.topic,
        "msgtype": topic.msgtype,
        "clock": clock,
        "lost_messages": limits.lost_messages,
        **limits.changed("cloud_points"),
    }
    family: Literal["radar", "cloud"] = "radar" if isinstance(channel, RadarChannel) else "cloud"
    plugin = require_type(name, channel.topic, topic.msgtype, family)
    params |= plugin
    if isinstance(channel, RadarChannel):
        if plugin and channel.azimuth_positive is not None:
            raise RecipeError(
                f"{name}: azimuth_positive has no effect on {channel.topic}, whose {topic.msgtype} a plug-in of "
                f"{plugin['decoder']['distribution']} decodes; remove it from the recipe."
            )
        params["azimuth_positive"] = channel.azimuth_positive
        return Request(params, (channel.topic,))
    params |= channel.model_dump(
        mode="json", include={"stamp", "stamp_offset_s", "deskew", "min_range_m", "max_range_m"}
    )
    if _holds_clouds(params):
        given = [field for field in ("model", "cut_angle_deg") if getattr(channel, field) is not None]
        if given:
            raise RecipeError(
                f"{name}: {' and '.join(given)} can be set for Velodyne packets only, but {channel.topic} "
                f"carries {topic.msgtype}; remove it from the recipe."
            )
        params |= {"header_stamp_is": channel.header_stamp_is}
        # Only what the header is said to mean asks for the length of a revolution.
        params |= {"period_ns": None if channel.header_stamp_is is None else topic.period_ns}
    else:
        params |= {"model": channel.model, "cut_angle_deg": channel.cut_angle_deg}
    if not channel.deskew:
        return Request(params, (channel.topic,))
    if ego_SE3_sensor is None:
        raise CalibrationError(
            f"{name}: to deskew it, its extrinsics must be known; give them in the recipe or set deskew: false."
        )
    if ego_poses_digest is None:
        raise PoseError(f"{name}: to deskew it, ego poses are needed; mend ego_pose or set deskew: false.")
    params["ego_SE3_sensor"] = {key: list(ego_SE3_sensor[key]) for key in ("translation", "rotation")}
    return Request(params, (channel.topic,), {"ego_poses": ego_poses_digest})


def _holds_clouds(params: Mapping[str, Any]) -> bool:
    """Tell whether the messages of a lidar are clouds; else they are searched for Velodyne packets."""
    return params["msgtype"] in CLOUD_DECODERS or "decoder" in params


class SweepExtractor:
    """Turns the messages of one lidar or radar channel into the files of an artifact.

    Args:
        params: as made by `request`.
        recording: decodes the messages.
        out: the artifact.
        trajectory: `global_SE3_ego`, needed if the channel is deskewed.
    """

    def __init__(
        self,
        params: Mapping[str, Any],
        recording: Recording,
        out: ArtifactWriter,
        trajectory: Trajectory | None = None,
    ) -> None:
        self.topics: tuple[str, ...] = (params["topic"],)
        self._params = params
        self._recording = recording
        self._most_points = Limits.of(params).cloud_points
        self._messages = 0
        self._failed_messages = 0
        self._failed_parts = 0
        self._first_error: str | None = None
        self._frame_id: str | None = None
        lidar = params["modality"] == "lidar"
        self._holds_packets = lidar and not _holds_clouds(params)
        self._files = SweepFiles(out, ".pcd.bin" if lidar else ".pcd", with_span=lidar)
        self._sweeps: CloudSweeps | PacketSweeps | RadarSweeps
        if not lidar:
            self._sweeps = RadarSweeps(params, self._files)
            return
        if params["deskew"] and trajectory is None:
            raise PoseError(f"{params['channel']}: to deskew it, ego poses are needed.")
        writer = LidarWriter(params, self._files, trajectory)
        if self._holds_packets:
            self._sweeps = PacketSweeps(params, writer, self._fail_parts)
        else:
            self._sweeps = CloudSweeps(params, writer)

    def add(self, message: RawMessage) -> None:
        """Take the next message; one that cannot be decoded is counted as lost."""
        self._messages += 1
        failed_before = self._failed_parts
        try:
            frame_id = self._take(message)
            self._frame_id = self._frame_id or frame_id
        except DecodeError as err:
            self._files.counts.read += 1
            self._fail_parts(str(err), 1)
        self._failed_messages += self._failed_parts > failed_before

    def finish(self) -> dict[str, Any]:
        """Write what is left and the index; return the summary.

        Raises:
            LossLimitError: more was lost than the recipe allows, or the counts do not add up.
        """
        self._sweeps.finish()
        self._check()
        params, files = self._params, self._files
        facts = {
            "counts": files.counts.as_json(),
            "messages": self._messages,
            "points": files.points.as_json(),
        }
        files.finish(
            {
                "channel": params["channel"],
                "modality": params["modality"],
                "topic": params["topic"],
                "frame_id": self._frame_id or "",
                "fileformat": "pcd",
                "camera_intrinsic": [],
                **facts,
            }
        )
        return {**facts, "bytes": files.bytes}

    def _take(self, message: RawMessage) -> str:
        """Hand a message on to be written; return its frame."""
        if isinstance(self._sweeps, PacketSweeps):
            packet = self._recording.packet(message, PAYLOADS)
            if packet is not None:
                self._sweeps.add_packets([(packet.stamp_ns, packet.payload)], message.log_time_ns)
                return self._frame_id or normalise_frame(packet.frame_id)
        return self._sweeps.add(self._decoded(message), message)

    def _decoded(self, message: RawMessage) -> Any:
        decoded = self._recording.decode(message)
        check_points(decoded, self._most_points)
        if not self._holds_packets and "decoder" not in self._params:
            if not hasattr(decoded, "header"):
                raise DecodeError("it has no header")
            # Simulated time may start at 0, but does not stay there.
            if (
                self._params["clock"] == "header"
                and self._messages > 1
                and not stamp_ns(decoded.header.stamp)
            ):
                raise DecodeError(NO_STAMP)
        return decoded

    def _fail_parts(self, reason: str, number: int) -> None:
        self._failed_parts += number
        self._first_error = self._first_error or reason
        self._files.lose(reason, number)

    def _check(self) -> None:
        counts, points = self._files.counts, self._files.points
        where = f"{self._params['channel']}: topic {self._params['topic']}"
        shares = (
            (self._failed_messages, self._messages, "messages"),
            (self._failed_parts, counts.read, "packets"),
        )
        for failed, read, unit in shares:
            if failed > self._params["lost_messages"] * read:
                raise LossLimitError(
                    f"{where} lost {failed} of {read} {unit}; the first: {self._first_error}. "
                    "If that is acceptable raise limits.lost_messages in the recipe, else remove the channel "
                    "or mend the recording."
                )
        if not (counts.balanced and points.balanced):
            raise LossLimitError(
                f"{where}: counts do not add up, {counts.as_json()}, points {points.as_json()}; "
                "this is a bug of the step, please report it."
            )
