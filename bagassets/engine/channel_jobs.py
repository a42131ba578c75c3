"""What the extraction of one channel is handed, and the extractor that does it."""

from concurrent.futures import Executor

from bagassets.bags.model import Recording
from bagassets.engine.derived import Made
from bagassets.recipe.model import CameraChannel, Rig
from bagassets.steps import frames, sweeps
from bagassets.steps.channel import ChannelExtractor, Request
from bagassets.store.action import Step
from bagassets.store.artifact import ArtifactWriter

__all__ = ["asset_of_channel", "channel_request", "deskews", "make_extractor", "step_of_channel"]


def asset_of_channel(rig: Rig, channel: str) -> str:
    """Return the asset that a channel belongs to: `frames` or `sweeps`."""
    return "frames" if isinstance(rig.channels[channel], CameraChannel) else "sweeps"


def step_of_channel(rig: Rig, channel: str) -> Step:
    """Return the step that extracts a channel."""
    return frames.STEP if asset_of_channel(rig, channel) == "frames" else sweeps.STEP


def deskews(rig: Rig) -> bool:
    """Tell whether any sweeps of a rig are moved with the ego poses."""
    return any(getattr(channel, "deskew", False) for channel in rig.channels.values())


def channel_request(made: Made, name: str) -> Request:
    """Return what the extraction of a channel reads.

    Args:
        made: what is there of the recording.
        name: the channel.

    Raises:
        BagAssetsError: the channel cannot be extracted as the recipe asks.
    """
    channel, calibrated = made.rig.channels[name], made.calibration["channels"][name]
    clock, limits = made.recipe.clock_of(channel), made.recipe.limits
    if isinstance(channel, CameraChannel):
        return frames.request(name, channel, clock, limits, made.inventory, camera=calibrated["camera"])
    return sweeps.request(
        name,
        channel,
        clock,
        limits,
        made.inventory,
        ego_SE3_sensor=calibrated["ego_SE3_sensor"],
        ego_poses_digest=made.artifact("ego_poses").digest if deskews(made.rig) else None,
    )


def make_extractor(
    made: Made, name: str, request: Request, recording: Recording, out: ArtifactWriter, pool: Executor | None
) -> ChannelExtractor:
    """Return what turns the messages of a channel into files.

    Args:
        made: what is there of the recording.
        name: the channel.
        request: from `channel_request`.
        recording: the recording; only what was requested is read.
        out: the artifact.
        pool: threads that encode images.
    """
    view = recording.restrict(request.topics)
    if asset_of_channel(made.rig, name) == "frames":
        return frames.FrameExtractor(request.params, view, out, pool)
    trajectory = made.trajectory if request.params.get("deskew") else None
    return sweeps.SweepExtractor(request.params, view, out, trajectory)
