"""The assets of a recording: their names, what each reads, and what making one comes to."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

from bagassets.errors import BagAssetsError
from bagassets.escaping import visible
from bagassets.recipe.model import Recipe
from bagassets.store.action import Action
from bagassets.store.artifact import Artifact

__all__ = [
    "ASSETS",
    "OPTIONAL_ASSETS",
    "UPSTREAM",
    "AssetResult",
    "BuildFailure",
    "NotMadeError",
    "Skipped",
    "assets_of",
]

# What each asset reads of the others, in the order in which they are made.
UPSTREAM: dict[str, tuple[str, ...]] = {
    "inventory": (),
    "calibration": ("inventory",),
    "ego_poses": ("inventory",),
    "annotations": ("inventory", "calibration", "ego_poses"),
    "frames": ("inventory", "calibration"),
    "sweeps": ("inventory", "calibration", "ego_poses"),
    "nuscenes_tables": ("inventory", "calibration", "ego_poses", "annotations", "frames", "sweeps"),
    "vision_sequences": ("inventory", "calibration", "ego_poses", "frames"),
    "preview": ("inventory", "calibration", "ego_poses", "annotations", "frames", "sweeps"),
}
# Assets that the recipe may leave out. No dataset but their own depends on them.
OPTIONAL_ASSETS = ("vision_sequences", "preview")
ASSETS = tuple(asset for asset in UPSTREAM if asset not in OPTIONAL_ASSETS)


def assets_of(recipe: Recipe) -> tuple[str, ...]:
    """Return the assets that a recording has under this recipe, in the order in which they are made."""
    enabled = {"vision_sequences": recipe.vision is not None, "preview": recipe.preview.enabled}
    return tuple(asset for asset in UPSTREAM if enabled.get(asset, True))


@dataclass(frozen=True)
class AssetResult:
    """What one asset of the recording came to.

    Attributes:
        asset: its name.
        artifact: its content; the digest is the data version.
        action_digest: the action that made it.
        cached: nothing had to run.
        seconds: time it took when it ran.
        channels: channel -> digest of its artifact, for assets that consist of channels.
    """

    asset: str
    artifact: Artifact
    action_digest: str
    cached: bool
    seconds: float
    channels: Mapping[str, str] = field(default_factory=dict)


@dataclass(frozen=True)
class Skipped:
    """The recording takes no part in the dataset, for a reason in words."""

    reason: str


class BuildFailure(BagAssetsError):  # noqa: N818  (a state of a build, named as users see it)
    """Some assets of a recording could not be made; one sentence for each, which names the recording."""

    def __init__(self, errors: Mapping[str, BagAssetsError], path: Path) -> None:
        self.errors = dict(errors)
        told = [str(err) for err in self.errors.values()]
        where = visible(str(path))
        told = [line if where in text else f"{where}: {line}" for text in told for line in text.split("\n")]
        super().__init__(*told)


class NotMadeError(BagAssetsError):
    """An action is not known to the store, in a walk that must not run it.

    For an asset that consists of channels, `channels` holds the actions of those that are not known.
    """

    def __init__(
        self, action: Action, failure: str | None, channels: Mapping[str, Action] | None = None
    ) -> None:
        self.action = action
        self.failure = failure
        self.channels = dict(channels or {})
        super().__init__(f"step {action.step} has not run on this input")
