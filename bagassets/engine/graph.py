"""The graph of one recording: a node for everything that is made from it, expanded as far as its inputs are known.

The nodes are the recording itself (`bag`), whether it takes part (`selection`), its assets, and below them nodes that
users never name: channels (an asset of channels is their index) and what is made along with an asset, such as
the track. A node has the action that makes it and its outcome, or why there is none. The graph reads the store and
files beside the recording; it makes nothing. `bagassets.engine.execute` runs actions and settles nodes with the results;
nodes that waited for these are then expanded again. Errors are not raised here: each belongs to the node that it
concerns.
"""

from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import cached_property
from typing import Self

from bagassets.assets.asset import AnyAsset, AnyUse
from bagassets.assets.inventory import INVENTORY
from bagassets.assets.selection import choose_rig, skip_reason
from bagassets.base.errors import BagAssetsError, RecipeError
from bagassets.base.json_types import JsonMapping
from bagassets.base.unexpected import explained_error
from bagassets.engine.differences import compare_actions, describe_changes
from bagassets.engine.inputs import RecordingInputs, not_materialized
from bagassets.engine.plan import AssetState, Recorded, skip_version, version_as_input
from bagassets.engine.recording_assets import RecordingAssets
from bagassets.engine.source import MessageSource
from bagassets.recipe.model import Rig
from bagassets.recordings.digest import RecordingStat, recording_digest, recording_stat
from bagassets.recordings.model import RecordingFiles
from bagassets.store.action import Action, Step
from bagassets.store.artifact import Artifact
from bagassets.store.store import Outcome

BAG, SELECTION = "bag", "selection"
_INDEX_VERSION = 1
_NO_RECORD = "the record of the action that made it is gone"
_UNCHANGED = AssetState("fresh", "size and time unchanged")


@dataclass(eq=False)
class Node:
    """Something that is made from a recording, or a fact about it that others depend on.

    At most one of `artifact`, `error`, `skipped` and `waits_for` is set; if none is, the node has yet to be made.

    Attributes:
        name: name of the asset, followed by the channel if the node is one.
        asset: name of the asset that it is or belongs to.
        channel: the channel, if the node is one.
        use: what its action reads; None for an index of channels.
        action: the action that makes it; None until its inputs are known.
        outcome: the outcome of the action.
        artifact: its content.
        error: why it cannot be made, or failed.
        skipped: why the recording takes no part.
        waits_for: the node that has to be known first.
        parts: the channels of an asset of channels.
    """

    name: str
    asset: str
    channel: str = ""
    use: AnyUse | None = None
    action: Action | None = None
    outcome: Outcome | None = None
    artifact: Artifact | None = None
    error: BagAssetsError | None = None
    skipped: str | None = None
    waits_for: str | None = None
    parts: tuple["Node", ...] = ()

    @property
    def is_open(self) -> bool:
        """True if its action is known, but has neither a result nor an error yet."""
        return self.action is not None and self.artifact is None and self.error is None

    @property
    def known_action(self) -> Action:
        """The action of a node that can be made."""
        if self.action is None:
            raise TypeError(f"the action of {self.name} is not known")
        return self.action

    @property
    def data_version(self) -> str | None:
        """What Dagster is to record of it, if that is known."""
        if self.skipped is not None:
            return skip_version(self.skipped)
        return None if self.artifact is None else self.artifact.digest

    @property
    def is_cached(self) -> bool:
        """True if no action had to run for it."""
        return (self.outcome is None or self.outcome.cached) and all(part.is_cached for part in self.parts)

    @property
    def below(self) -> Iterable["Node"]:
        """The nodes whose actions make its content: its channels, or itself."""
        return self.parts or (self,)


@dataclass
class Graph:
    """The nodes of one recording.

    Attributes:
        assets: the assets of a recording under the recipe.
        recording: its files.
        digest: its content digest; None if it is not known, and then nothing else is.
        stat: sizes and times of its files when the digest was taken.
        wanted: names of the assets that are made here; default: all.
        given: asset -> current artifact, for assets that are not made here.
        failures: asset that is neither made here nor given -> why it could not be made when that was last tried, if known.
        lookup: returns the outcome of an action if it is known; default: `Store.lookup`.
        bag: state of the recording itself.
        recorded: asset -> what Dagster recorded last; the states compare with it.
    """

    assets: RecordingAssets
    recording: RecordingFiles
    digest: str | None
    stat: RecordingStat
    wanted: Collection[str] | None = None
    given: Mapping[str, Artifact] = field(default_factory=dict)
    failures: Mapping[str, str] = field(default_factory=dict)
    lookup: Callable[[Action], Outcome | None] | None = None
    bag: AssetState = _UNCHANGED
    recorded: Mapping[str, Recorded] = field(default_factory=dict)
    _nodes: dict[str, Node] = field(default_factory=dict, init=False)

    def __post_init__(self) -> None:
        given = {name: artifact for name, artifact in self.given.items() if not self.makes(name)}
        recipe, self.store = self.assets.recipe, self.assets.store
        self.source = MessageSource(self.recording, self.stat, recipe.bags.message_definitions, recipe.limits)
        self.inputs = RecordingInputs(self.store, self.recording, self.digest or "", self.source, given)

    @classmethod
    def of(cls, assets: RecordingAssets, recording: RecordingFiles) -> Self:
        """Return the graph of a recording as it is on disk, whose files are hashed unless their digest is on record.

        Raises:
            RecordingError: it is gone, or changes while it is hashed.
        """
        stat = recording_stat(recording)
        digest = recording_digest(recording, assets.index)
        return cls(assets, recording, digest.digest, stat.as_of(digest))

    # --- nodes ---------------------------------------------------------------------------

    def makes(self, name: str) -> bool:
        """Return whether an asset is made here, not given."""
        return self.wanted is None or name in self.wanted or name in self.assets.hidden

    def node(self, name: str) -> Node:
        """Return a node by name, expanded as far as its inputs are known.

        Args:
            name: `bag`, `selection`, or an asset, even one that is only made along with another.
        """
        if name not in self._nodes:
            node = self._expanded(name)
            # A read that failed once must not cost a dataset this recording.
            is_transient = node.error is not None and node.error.transient
            self._nodes[name] = self._expanded(name) if is_transient else node
        return self._nodes[name]

    def nodes(self) -> Iterator[Node]:
        """Yield the nodes that can have artifacts: each asset after its channels, then those made along with it."""
        for asset in self.assets:
            node = self.node(asset.name)
            yield from node.parts
            yield node
            for hidden in asset.along:
                yield self.node(hidden.name)

    def above(self, asset: AnyAsset) -> list[str]:
        """Return the names of the nodes that an asset depends on under the parameters of this recording."""
        if not asset.reads:
            return [BAG]
        names = [one.name for one in asset.reads]
        if self.rig is not None and asset.waits_for is not None:
            inventory = None if self.node(INVENTORY.name).artifact is None else self.inputs.inventory
            needs = asset.needs(self.assets.params(asset, self.rig), inventory)
            names = [name for name in names if name in needs]
        return [SELECTION, *names]

    @cached_property
    def rig(self) -> Rig | None:
        """The rig that made the recording."""
        return choose_rig(self.assets.recipe, *self.recording.names)

    def inputs_above(self, node: Node) -> RecordingInputs:
        """Return the inputs of one node: what is known of the nodes that it depends on, and nothing else."""
        names = [asset.name for asset in self.assets[node.asset].reads]
        artifacts = {name: above for name in names if (above := self.node(name).artifact) is not None}
        return RecordingInputs(self.store, self.recording, self.digest or "", self.source, artifacts)

    def settle(self, node: Node, result: Outcome | BagAssetsError) -> None:
        """Set the result of a node's action, and forget the nodes that waited, so that they are expanded again."""
        if isinstance(result, BagAssetsError):
            node.error = None if self._fall_back(node) else result
        else:
            self._set_outcome(node, result)
        if node.channel:
            self._expand_index(self.node(node.asset))
        self._nodes = {name: one for name, one in self._nodes.items() if one.waits_for is None}

    # --- expansion -----------------------------------------------------------------------

    def _expanded(self, name: str) -> Node:
        node = Node(name, name)
        if name == BAG:
            node.waits_for = None if self.digest is not None else "its content"
        elif name == SELECTION:
            self._expand_selection(node)
        elif self.makes(name):
            self._expand(node, self.assets[name])
        elif name in self.given:
            node.artifact = self.given[name]
        else:
            node.error = not_materialized(self.recording.key, name, self.failures.get(name))
        return node

    def _expand_selection(self, node: Node) -> None:
        inventory = self.node(INVENTORY.name)
        if inventory.artifact is None:
            is_here = self.makes(INVENTORY.name)
            node.waits_for, node.error = (INVENTORY.name, None) if is_here else (None, inventory.error)
            return
        with _noted(node, self.recording):
            node.skipped = skip_reason(self.assets.recipe, self.rig, self.inputs.inventory)
            if node.skipped is None and self.rig is not None and self.rig.questions:
                raise RecipeError(*self.rig.questions)

    def _expand(self, node: Node, asset: AnyAsset) -> None:
        for name in self.above(asset):
            above = self.node(name)
            if above.skipped is not None:
                node.skipped = above.skipped
            elif above.error is not None and (name == SELECTION or not self.makes(name)):
                node.error = above.error  # nothing that is made here would change it
            elif above.waits_for or (above.artifact is None and name not in {BAG, SELECTION}):
                node.waits_for = INVENTORY.name if name == SELECTION else name
            if node.skipped or node.error or node.waits_for:
                return
        with _noted(node, self.recording):
            uses = asset.use(self.assets.params(asset, self.rig or self.assets.recipe.rigs[0]), self.inputs)
            if asset.extract is None:
                self._expand_action(node, asset, uses[""])
            else:
                node.parts = tuple(
                    Node(f"{asset.name} {channel}", asset.name, channel) for channel in sorted(uses)
                )
                for part in node.parts:
                    with _noted(part, self.recording):
                        self._expand_action(part, asset, uses[part.channel])
                self._expand_index(node)

    def _expand_action(self, node: Node, asset: AnyAsset, use: AnyUse | Exception) -> None:
        if isinstance(use, Exception):
            raise use
        node.use = use
        node.action = asset.action(use, self.inputs.inventory if use.topics else None)
        self._look_up(node)
        self._fall_back(node)

    def _fall_back(self, node: Node) -> bool:
        """Give a node whose action has failed what its asset tries then; return whether there is anything."""
        asset = self.assets[node.asset]
        if asset.fallback is None or node.use is None or node.action is None or not node.is_open:
            return False
        why = self.store.failure(node.action.digest, self.recording.path)
        instead = None if why is None else asset.fallback(node.use, why)
        if instead is None:
            return False
        node.use, node.action = instead, asset.action(instead, None)
        self._look_up(node)
        return True

    def _expand_index(self, node: Node) -> None:
        """Expand the index of an asset of channels, which is made once all channels are known."""
        if any(part.is_open for part in node.parts):
            return
        errors = [part.error for part in node.parts if part.error is not None]
        if errors:
            node.error = errors[0]
            return
        outcomes = {part.channel: part.outcome for part in node.parts if part.outcome is not None}
        digests = {f"channel:{name}": outcome.artifact.digest for name, outcome in outcomes.items()}
        actions = {name: outcome.action_digest for name, outcome in outcomes.items()}
        node.action = Step(f"{node.asset}_index", _INDEX_VERSION).action({"actions": actions}, digests)
        with _noted(node, self.recording):
            self._look_up(node)

    def _look_up(self, node: Node) -> None:
        if node.action is not None:
            outcome = (self.lookup or self.store.lookup)(node.action)
            if outcome is not None:
                self._set_outcome(node, outcome)

    def _set_outcome(self, node: Node, outcome: Outcome) -> None:
        node.outcome, node.artifact = outcome, outcome.artifact
        if not node.channel:
            self.inputs.add(node.name, outcome.artifact)

    # --- states --------------------------------------------------------------------------

    def states(self) -> dict[str, AssetState]:
        """Return asset -> its state; `bag` comes first."""
        nodes = {asset.name: self.node(asset.name) for asset in self.assets}
        current = {name: record.data_version for name, record in self.recorded.items()}
        current |= {} if self.digest is None else {BAG: self.digest}
        current |= {name: known for name, node in nodes.items() if (known := node.data_version) is not None}
        states = {BAG: self.bag}
        for name, node in nodes.items():
            states[name] = self._state(node, current, states)
        return states

    def _failure(self, node: Node) -> AssetState | None:
        """Return the state of a node that cannot be made, or whose action failed when it ran last; None if it did not."""
        if node.error is not None:
            return AssetState("failed", str(node.error), is_final=True)
        if node.parts:
            return next((one for part in node.parts if (one := self._failure(part)) is not None), None)
        if node.action is None or not node.is_open:
            return None
        why = self.store.failure(node.action.digest, self.recording.path)
        return None if why is None else AssetState("failed", why)

    def _state(self, node: Node, current: Mapping[str, str], states: Mapping[str, AssetState]) -> AssetState:
        recorded = self.recorded.get(node.name)
        if node.data_version is not None:
            state = self._known_state(node.data_version, node.name, current, states)
            if node.skipped is None:
                return state
            return AssetState("skipped", node.skipped, to_record=state.state != "fresh")
        if node.waits_for is not None:
            reason = states[node.waits_for].reason
            # Name only the first cause: "waits for frames — waits for calibration — …" would say less.
            if not reason.startswith("waits for"):
                reason = f"waits for {node.waits_for} — {reason}"
            is_new = self.digest is None and recorded is None
            return AssetState("missing" if is_new else "unknown", reason)
        failure = self._failure(node)
        if failure is not None:
            return failure
        if recorded is None:
            return AssetState("missing", "never made")
        return AssetState("stale", self._what_changed(node, recorded))

    def _known_state(
        self, digest: str, name: str, current: Mapping[str, str], states: Mapping[str, AssetState]
    ) -> AssetState:
        recorded = self.recorded.get(name)
        if recorded is None:
            return AssetState("record-only", "the store has it, Dagster has no record", digest)
        if recorded.data_version != digest:
            return AssetState("record-only", "the store has the result for the new inputs", digest)
        if changes := self.assets.version_changes(name, recorded.code_version):
            return AssetState("record-only", f"{changes} changed, the result did not", digest)
        for above, data_version in recorded.inputs.items():
            if above in current and version_as_input(current[above]) != data_version:
                state = states.get(above)
                why = "made again" if state is None or state.state == "fresh" else state.reason
                return AssetState("record-only", f"{above} changed ({why}), but the result did not", digest)
        return AssetState("fresh", "up to date", digest)

    def _what_changed(self, node: Node, recorded: Recorded) -> str:
        """Return a text that names the differences between a node's action and the one that Dagster recorded last."""
        if recorded.is_skip:
            return f"the recording was skipped before: {recorded.why_skipped}"
        before = None if recorded.action is None else self.store.action(recorded.action)
        if before is None:
            return _NO_RECORD
        if node.action is not None:
            return _difference(before, node.action)
        reasons = []
        actions = before["params"].get("actions", {})
        for part in node.parts:
            if part.action is None or not part.is_open:
                continue
            if part.channel not in actions:
                reasons.append(f"{part.channel} is new")
                continue
            old = self.store.action(actions[part.channel])
            reasons.append(f"{part.channel}: {_NO_RECORD if old is None else _difference(old, part.action)}")
        return "; ".join(reasons)


def _difference(before: JsonMapping, now: Action) -> str:
    return describe_changes(compare_actions(before, now.as_json())) or "its artifact is gone from the store"


@contextmanager
def _noted(node: Node, recording: RecordingFiles) -> Iterator[None]:
    """Keep an error that is raised inside with the node that it concerns."""
    try:
        yield
    except Exception as err:  # noqa: BLE001  (any error costs this node only)
        node.error = explained_error(err, recording.path, node.channel or node.name)
