"""The assets of one recording: the actions behind them, and running those not known yet.

`RecordingBuild.build` walks the chain inventory -> calibration -> … -> nuscenes_tables. Each
asset is an action keyed by what it reads; frames and sweeps are one action per channel,
filled together in one pass over the recording. `RecordingBuild.known` walks the same chain
without running anything.
"""

from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from contextlib import nullcontext
from functools import cached_property, partial
from typing import Any

from bagassets.annotations.files.find import find_labels
from bagassets.bags.digest import RecordingStat
from bagassets.bags.inventory import Inventory
from bagassets.bags.model import Found, Recording
from bagassets.engine.channel_jobs import (
    asset_of_channel,
    channel_request,
    deskews,
    make_extractor,
    step_of_channel,
)
from bagassets.engine.channel_pass import ChannelJob, run_pass
from bagassets.engine.derived import DERIVED
from bagassets.engine.process import encoder_threads, keep_freed_memory
from bagassets.engine.recording_assets import (
    ASSETS,
    OPTIONAL_ASSETS,
    UPSTREAM,
    AssetResult,
    BuildFailure,
    NotMadeError,
    Skipped,
    assets_of,
)
from bagassets.engine.source import MessageSource
from bagassets.engine.unexpected import in_words
from bagassets.errors import BagAssetsError, StoreError
from bagassets.geometry.trajectory import Trajectory
from bagassets.recipe.model import Recipe, Rig
from bagassets.steps import (
    annotations,
    calibration,
    ego_poses,
    inventory,
)
from bagassets.steps.channel import Request
from bagassets.steps.selection import choose_rig, present_channels, skip_reason
from bagassets.store.action import Action, Step
from bagassets.store.artifact import Artifact, ArtifactWriter
from bagassets.store.canonical import digest_file
from bagassets.store.lease import in_use
from bagassets.store.store import Outcome, Store
from bagassets.trace import span

__all__ = ["ASSETS", "UPSTREAM", "AssetResult", "BuildFailure", "NotMadeError", "RecordingBuild", "Skipped"]

# Frames and sweeps come from one pass over the recording.
_GROUPS = (
    ("calibration",),
    ("ego_poses",),
    ("annotations",),
    ("frames", "sweeps"),
    ("nuscenes_tables",),
    *((asset,) for asset in OPTIONAL_ASSETS),
)
_INDEX_STEPS = {name: Step(f"{name}_index", 1) for name in ("frames", "sweeps")}


class RecordingBuild:
    """Makes the assets of one recording.

    Args:
        recipe: the whole recipe; each step is handed just the fields it declares.
        store: where artifacts are.
        found: the recording.
        digest: its content digest, as the asset `bag` recorded it.
        stat: sizes and times of its files that the digest holds for.
        recorded: asset -> artifact that is current upstream, for assets that are not made here.
        workers: threads that encode images; default: one per processor.
        dry: run nothing; an action that is not known raises `NotMadeError`.
    """

    def __init__(
        self,
        recipe: Recipe,
        store: Store,
        found: Found,
        digest: str,
        stat: RecordingStat,
        recorded: Mapping[str, Artifact] | None = None,
        *,
        workers: int | None = None,
        dry: bool = False,
    ) -> None:
        self.recipe = recipe
        self.store = store
        self.found = found
        self.digest = digest
        self.source = MessageSource(found, stat, recipe.bags.message_definitions, recipe.limits)
        self._workers = encoder_threads() if workers is None else workers
        self._dry = dry
        self._artifacts: dict[str, Artifact] = dict(recorded or {})

    def build(self, wanted: Collection[str] | None = None) -> Iterator[AssetResult | Skipped]:
        """Make the `wanted` assets (default: all of the recipe) in order and yield each result.

        What is known is not run again.

        An asset that fails does not stop those that do not read it.

        Raises:
            BuildFailure: after everything else was made, if anything failed.
        """
        if not self._dry:
            keep_freed_memory()
        wanted = assets_of(self.recipe) if wanted is None else wanted
        with nullcontext() if self._dry else in_use(self.store.root):
            yield from self._build(wanted)

    def _build(self, wanted: Collection[str]) -> Iterator[AssetResult | Skipped]:
        if "inventory" in wanted:
            try:
                yield self._inventory()
            except BagAssetsError as err:
                raise BuildFailure({"inventory": err}, self.found.path) from err
        if self.skipped is not None:
            yield Skipped(self.skipped)
            return
        failed: dict[str, BagAssetsError] = {}
        blocked: set[str] = set()
        for group in _GROUPS:
            ready = []
            for asset in group:
                if asset not in wanted:
                    continue
                if self._reads(asset) & (failed.keys() | blocked):
                    blocked.add(asset)
                else:
                    ready.append(asset)
            for asset, made in self._make(ready).items():
                if isinstance(made, AssetResult):
                    yield made
                else:
                    failed[asset] = made
        if failed:
            raise BuildFailure(failed, self.found.path)

    # --- what steps are handed -----------------------------------------------------------

    @cached_property
    def inventory(self) -> Inventory:
        """The typed inventory of the recording."""
        return Inventory.from_json(self.artifact("inventory").read_json("inventory.json"))

    @cached_property
    def skipped(self) -> str | None:
        """Why the recording takes no part in the dataset, or None; known once it has an inventory."""
        return skip_reason(self.recipe, self._matching_rig, self.inventory)

    @cached_property
    def rig(self) -> Rig:
        """The rig that made the recording; only asked for when it is not skipped."""
        rig = self._matching_rig
        if rig is None:
            raise BagAssetsError(f"{self.found.path}: no rig of the recipe matches; correct rigs[].match.")
        return rig

    @cached_property
    def _matching_rig(self) -> Rig | None:
        return choose_rig(self.recipe, self.found.relative)

    @cached_property
    def _present(self) -> dict[str, str]:
        return present_channels(self.rig, self.inventory)

    @cached_property
    def calibration(self) -> dict[str, Any]:
        """Content of `calibration.json`."""
        calibrated: dict[str, Any] = self.artifact("calibration").read_json("calibration.json")
        return calibrated

    @cached_property
    def trajectory(self) -> Trajectory:
        """`global_SE3_ego`."""
        return ego_poses.load_trajectory(self.artifact("ego_poses"))

    def artifact(self, asset: str) -> Artifact:
        """Return the artifact of an asset that was made before.

        Raises:
            StoreError: it was not.
        """
        try:
            return self._artifacts[asset]
        except KeyError:
            raise StoreError(
                f"{self.found.key}: {asset} is not materialized for this recording; materialize {asset} first."
            ) from None

    def _reads(self, asset: str) -> set[str]:
        reads = set(UPSTREAM[asset])
        if asset == "sweeps" and not deskews(self.rig):
            reads.discard("ego_poses")
        return reads

    # --- running actions -----------------------------------------------------------------

    def _make(self, assets: Sequence[str]) -> dict[str, AssetResult | BagAssetsError]:
        makers: dict[str, Callable[[], AssetResult]] = {
            "calibration": self._calibration,
            "ego_poses": self._ego_poses,
            "annotations": self._annotations,
            **{asset: partial(self._derived, asset) for asset in DERIVED},
        }
        if not assets:
            return {}
        if assets[0] not in makers:
            return self._extract(assets)
        try:
            return {assets[0]: makers[assets[0]]()}
        except Exception as err:  # noqa: BLE001  (whatever it is, it costs no more than this asset)
            return {assets[0]: in_words(err, self.found.path, assets[0])}

    def _run(
        self, asset: str, action: Action, make: Callable[[ArtifactWriter], dict[str, Any]]
    ) -> AssetResult:
        def told(out: ArtifactWriter) -> dict[str, Any]:
            try:
                return make(out)
            except BagAssetsError:
                raise
            except Exception as err:  # whatever it is, it costs no more than this asset
                raise in_words(err, self.found.path, asset) from err

        with span(asset):
            outcome = (
                self.store.lookup(action) if self._dry else self.store.run(action, told, self.found.path)
            )
        if outcome is None:
            raise NotMadeError(action, self.store.failure(action.digest, self.found.path))
        self._artifacts[asset] = outcome.artifact
        return AssetResult(asset, outcome.artifact, outcome.action_digest, outcome.cached, outcome.seconds)

    def _action(self, step: Step, request: Request) -> Action:
        topics = {f"topic:{name}": digest for name, digest in self.inventory.digests(request.topics).items()}
        return step.action(request.params, {**topics, **request.inputs})

    def _run_on_messages(
        self,
        asset: str,
        step: Step,
        request: Request,
        make: Callable[[Mapping[str, Any], Recording, ArtifactWriter], dict[str, Any]],
    ) -> AssetResult:
        def run(out: ArtifactWriter) -> dict[str, Any]:
            with self.source.topics(request.topics, self.inventory, self.artifact("inventory")) as recording:
                return make(request.params, recording, out)

        return self._run(asset, self._action(step, request), run)

    # --- the assets ----------------------------------------------------------------------

    def _inventory(self) -> AssetResult:
        definitions = {
            f"msg:{path.relative_to(folder).as_posix()}": digest_file(path)
            for folder in self.recipe.bags.message_definitions
            for path in sorted(folder.rglob("*.msg"))
        }

        def make(out: ArtifactWriter) -> dict[str, Any]:
            with self.source.whole() as recording:
                return inventory.make_inventory(recording, out, size=self.found.size)

        request = inventory.request(self.found.format, self.digest, definitions, self.recipe.limits)
        return self._run("inventory", inventory.STEP.action(request.params, request.inputs), make)

    def _calibration(self) -> AssetResult:
        request = calibration.request(self.rig, self.inventory)
        urdf = None if self.rig.urdf is None else self.rig.urdf.read_bytes()
        return self._run_on_messages(
            "calibration", calibration.STEP, request, partial(calibration.make, urdf=urdf)
        )

    def _ego_poses(self) -> AssetResult:
        request = ego_poses.request(self.rig, self.recipe.clock, self.inventory, self.recipe.limits)
        return self._run_on_messages("ego_poses", ego_poses.STEP, request, ego_poses.make)

    def _annotations(self) -> AssetResult:
        labels = find_labels(self.rig, self.found)
        request = annotations.request(
            self.rig,
            self.recipe.clock,
            self.recipe.limits,
            self.inventory,
            calibration=self.calibration,
            ego_poses=self.artifact("ego_poses"),
            labels=labels,
        )
        make = partial(annotations.make, trajectory=self.trajectory, labels=labels)
        return self._run_on_messages("annotations", annotations.STEP, request, make)

    def _derived(self, asset: str) -> AssetResult:
        step, request, make = DERIVED[asset](self)
        return self._run(asset, self._action(step, request), make)

    # --- frames and sweeps ---------------------------------------------------------------

    def _extract(self, assets: Sequence[str]) -> dict[str, AssetResult | BagAssetsError]:
        """Fill all stale channels of `assets` in one pass, then index each asset's channels."""
        outcomes: dict[str, Outcome] = {}
        errors: dict[str, BagAssetsError] = {}
        jobs: list[ChannelJob] = []
        for name in self._channels_of(assets):
            try:
                request = channel_request(self, name)
                action = self._action(step_of_channel(self.rig, name), request)
                known = self.store.lookup(action) if self._dry else self.store.use(action)
                if known is not None:
                    outcomes[name] = known
                elif self._dry:
                    errors[name] = NotMadeError(action, self.store.failure(action.digest, self.found.path))
                else:
                    jobs.append(
                        ChannelJob(name, action, request.topics, partial(make_extractor, self, name, request))
                    )
            except Exception as err:  # noqa: BLE001  (as in `_make`)
                errors[name] = in_words(err, self.found.path, name)
        if jobs:
            try:
                topics = {topic for job in jobs for topic in job.topics}
                with (
                    span("frames and sweeps", channels=[job.channel for job in jobs]),
                    self.source.whole(self.inventory) as recording,
                ):
                    made, failed = run_pass(
                        recording.restrict(topics),
                        jobs,
                        self.store,
                        self.source.verify_unchanged,
                        threads=self._workers,
                    )
            except BagAssetsError as err:
                made, failed = {}, {job.channel: err for job in jobs}
            outcomes |= made
            errors |= failed
        return {asset: self._index(asset, outcomes, errors) for asset in assets}

    def _index(
        self, asset: str, outcomes: Mapping[str, Outcome], errors: Mapping[str, BagAssetsError]
    ) -> AssetResult | BagAssetsError:
        """Make the artifact of an asset that names the artifacts of its channels."""
        names = self._channels_of([asset])
        failed = [errors[name] for name in names if name in errors]
        if failed:
            unmade = {name: err for name in names if isinstance(err := errors.get(name), NotMadeError)}
            told = [err for err in failed if not isinstance(err, NotMadeError) or err.failure is not None]
            if told:
                return told[0]
            actions = {name: err.action for name, err in unmade.items()}
            return NotMadeError(next(iter(actions.values())), None, actions)
        channels = {
            name: {
                "artifact": outcomes[name].artifact.digest,
                "action": outcomes[name].action_digest,
                "counts": outcomes[name].artifact.summary()["counts"],
            }
            for name in names
        }
        digests = {f"channel:{name}": entry["artifact"] for name, entry in channels.items()}
        actions = {name: entry["action"] for name, entry in channels.items()}

        def make(out: ArtifactWriter) -> dict[str, Any]:
            out.write_json("channels.json", channels)
            return {
                "channels": {name: entry["counts"] for name, entry in channels.items()},
                "bytes": sum(outcomes[name].artifact.summary()["bytes"] for name in names),
            }

        action = _INDEX_STEPS[asset].action({"actions": actions}, digests)
        outcome = self.store.lookup(action) if self._dry else self.store.run(action, make)
        if outcome is None:
            return NotMadeError(action, None)
        self._artifacts[asset] = outcome.artifact
        cached = outcome.cached and all(outcomes[name].cached for name in names)
        seconds = sum(outcomes[name].seconds for name in names)
        parts = {name: entry["artifact"] for name, entry in channels.items()}
        return AssetResult(asset, outcome.artifact, outcome.action_digest, cached, seconds, parts)

    def _channels_of(self, assets: Sequence[str]) -> list[str]:
        wanted = {"frames": "frames" in assets, "sweeps": "sweeps" in assets}
        return [name for name in self._present if wanted[asset_of_channel(self.rig, name)]]

    def channels(self, asset: str) -> dict[str, Artifact]:
        """Return channel -> artifact of `frames` or `sweeps`."""
        channels = self.artifact(asset).read_json("channels.json")
        return {name: self.store.artifact(entry["artifact"]) for name, entry in channels.items()}
