"""Running the actions of a graph whose results are not known; nothing else runs a node of a graph.

All channels that need a pass over the recording share one: passes are what costs, since reading topic after topic from
a compressed recording would decompress each chunk once per topic. In a pass, a channel that fails does not stop the
others, and a recording that changes meanwhile fails them all.
"""

from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, field
from itertools import islice
from pathlib import Path

from bagassets.assets.asset import AnyAsset, Inputs, Summary
from bagassets.assets.channel import ChannelExtractor
from bagassets.base.errors import BagAssetsError, StoreError
from bagassets.base.escaping import visible
from bagassets.base.trace import span
from bagassets.base.unexpected import explained_error
from bagassets.engine.graph import SELECTION, Graph, Node
from bagassets.engine.process import encoder_threads, encoders, keep_freed_memory
from bagassets.engine.run_action import run_action
from bagassets.recordings.recording import Recording
from bagassets.store.artifact import Artifact, ArtifactWriter
from bagassets.store.lease import in_use
from bagassets.store.store import Outcome, Pending, Store

# The images of a smaller recording are encoded sooner than threads are started.
_WORTH_THREADS_BYTES = 1_000_000


@dataclass(frozen=True)
class AssetResult:
    """The result of one asset of the recording.

    Attributes:
        asset: its name.
        artifact: its content; the digest is the data version.
        action_digest: the action that made it.
        cached: True if nothing had to run.
        seconds: time that it took when it ran.
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
    """An asset that is not made, as its recording takes no part in the dataset; `reason` says why."""

    asset: str
    reason: str


class BuildFailure(BagAssetsError):  # noqa: N818  (a state of a build, named as users see it)
    """Some assets of a recording could not be made; there is one sentence for each, which names the recording."""

    def __init__(self, errors: Mapping[str, BagAssetsError], path: Path) -> None:
        self.errors = dict(errors)
        texts = [str(err) for err in self.errors.values()]
        where = visible(str(path))
        lines = [line if where in text else f"{where}: {line}" for text in texts for line in text.split("\n")]
        super().__init__(*dict.fromkeys(lines))  # of two assets that fail alike, once


def execute(graph: Graph, *, threads: int | None = None) -> Iterator[AssetResult | Skipped]:
    """Make the assets that a graph wants, in order, and yield each result.

    Known actions are not run again. An asset that fails does not stop those that do not read it.

    Args:
        graph: the nodes of a recording.
        threads: number of threads that encode images; default: one per processor.

    Raises:
        BuildFailure: something failed; raised after everything else was made.
        StoreError: the inventory is not made here, and missing or unreadable.
    """
    keep_freed_memory()
    graph.lookup = graph.store.use  # the collector must spare what this run uses
    threads = encoder_threads() if threads is None else threads
    failed: dict[str, BagAssetsError] = {}
    with in_use(graph.store.root):
        for batch in _batches(graph):
            for node in _make_batch(graph, batch, threads):
                if node.outcome is not None:
                    yield _result(node, node.outcome)
                elif node.error is not None:
                    failed[node.name] = node.error
                elif node.skipped is not None:
                    yield Skipped(node.name, node.skipped)
        selection = graph.node(SELECTION)
        if selection.error is not None:
            raise selection.error
        if failed:
            raise BuildFailure(failed, graph.recording.path)


def _batches(graph: Graph) -> Iterator[Sequence[AnyAsset]]:
    """Yield the assets that are made together, once everything that they depend on was made or has failed.

    A pass over the recording comes last, so that everything that its channels depend on is made before.
    """
    waiting = [asset for asset in graph.assets if graph.makes(asset.name)]
    while waiting:
        names = {asset.name for asset in waiting}
        alone = (one for one in waiting if one.extract is None and names.isdisjoint(graph.above(one)))
        batch = [*islice(alone, 1)] or [one for one in waiting if names.isdisjoint(graph.above(one))]
        waiting = [asset for asset in waiting if asset not in batch]
        yield batch


def _make_batch(graph: Graph, batch: Sequence[AnyAsset], threads: int) -> list[Node]:
    """Make assets as far as possible, and return their nodes."""
    if batch[0].extract is None:
        (asset,) = batch
        with span(asset.name):
            node = graph.node(asset.name)
            _make(graph, node)
            for hidden in asset.along:
                # An error here is not reported: it recurs, and is, where the hidden asset is read.
                _make(graph, graph.node(hidden.name))
        return [node]
    nodes = [graph.node(asset.name) for asset in batch]
    channels = [part for node in nodes for part in node.parts if part.is_open]
    if channels:
        name = " and ".join(asset.name for asset in batch)
        with span(name, channels=[part.channel for part in channels]):
            made = _fill_channels(graph, channels, graph.store, threads)
        for part in channels:
            graph.settle(part, made[part.name])
    for node in nodes:
        _make(graph, node)
    return nodes


def run_again(
    graph: Graph, nodes: Sequence[Node], store: Store, *, threads: int
) -> dict[str, Outcome | BagAssetsError]:
    """Run the actions of nodes once more, each on the recorded artifacts of the nodes above it.

    Args:
        graph: the nodes of the recording; it is not changed.
        nodes: nodes of it whose actions are known.
        store: where artifacts are made.
        threads: number of threads that encode images.

    Returns:
        Name of the node -> result of its action.
    """
    channels = [node for node in nodes if node.channel]
    made = _fill_channels(graph, channels, store, threads) if channels else {}
    for node in nodes:
        if not node.channel:
            made[node.name] = _run_action(graph, node, graph.inputs_above(node), store)
    return made


def _result(node: Node, outcome: Outcome) -> AssetResult:
    parts = {part.channel: part.outcome for part in node.parts if part.outcome is not None}
    seconds = sum(one.seconds for one in parts.values()) if parts else outcome.seconds
    channels = {channel: one.artifact.digest for channel, one in parts.items()}
    return AssetResult(node.name, outcome.artifact, outcome.action_digest, node.is_cached, seconds, channels)


# --- one action ------------------------------------------------------------------------------


def _make(graph: Graph, node: Node) -> None:
    """Make a node if it can be, and settle it; if its action fails, what its asset tries then."""
    while node.is_open:
        graph.settle(node, _run_action(graph, node, graph.inputs, graph.store))


def _run_action(graph: Graph, node: Node, inputs: Inputs, store: Store) -> Outcome | BagAssetsError:
    path = graph.recording.path

    def make(out: ArtifactWriter) -> Summary:
        try:
            if node.use is None:
                return _write_index(node, out)
            return graph.assets[node.asset].run(node.use, inputs, out)
        except BagAssetsError:
            raise
        except Exception as err:  # any error costs this asset only
            raise explained_error(err, path, node.name) from err

    try:
        return run_action(store, node.known_action, make, path)
    except Exception as err:  # noqa: BLE001  (as above)
        return explained_error(err, path, node.name)


def _write_index(node: Node, out: ArtifactWriter) -> Summary:
    """Write the index of an asset's channels: which artifact each has."""
    outcomes = {part.channel: part.outcome for part in node.parts if part.outcome is not None}
    summaries = {channel: outcome.artifact.summary() for channel, outcome in outcomes.items()}
    out.write_json(
        "channels.json",
        {
            channel: {
                "artifact": outcome.artifact.digest,
                "action": outcome.action_digest,
                "counts": summaries[channel]["counts"],
            }
            for channel, outcome in outcomes.items()
        },
    )
    return {
        "channels": {channel: summary["counts"] for channel, summary in summaries.items()},
        "bytes": sum(summary["bytes"] for summary in summaries.values()),
    }


# --- one pass --------------------------------------------------------------------------------


def _fill_channels(
    graph: Graph, nodes: Sequence[Node], store: Store, threads: int
) -> dict[str, Outcome | BagAssetsError]:
    """Make channels in one pass over the recording; return node name -> result."""
    topics = {topic for node in nodes if node.use is not None for topic in node.use.topics}
    try:
        with graph.inputs.messages(tuple(sorted(topics))) as recording:
            return run_pass(graph, recording, nodes, store, threads)
    except Exception as err:  # noqa: BLE001  (the recording itself is at fault: nothing was recorded)
        error = explained_error(err, graph.recording.path, "the pass over the recording")
        return {node.name: error for node in nodes}


def run_pass(
    graph: Graph, recording: Recording, nodes: Sequence[Node], store: Store, threads: int
) -> dict[str, Outcome | BagAssetsError]:
    """Read the topics of all channels once, and finish each channel.

    A channel that fails does not stop the others; its error is recorded under its action. After the last message, and
    before anything is recorded, the recording is checked for changes. All channels share the threads.

    Args:
        graph: the nodes of the recording.
        recording: the opened recording.
        nodes: the channels.
        store: where artifacts are made.
        threads: number of threads that encode images.

    Returns:
        Name of the node -> its result.

    Raises:
        RecordingError: the recording is damaged or changed while it was read; nothing is recorded.
    """
    path = recording.path
    pending: dict[str, Pending] = {}
    extractors: dict[str, ChannelExtractor] = {}
    ended: dict[str, Summary | BagAssetsError] = {}
    channels = {node.name: node.channel for node in nodes}
    try:
        with encoders(threads if graph.recording.size > _WORTH_THREADS_BYTES else 1) as pool:
            for node in nodes:
                pending[node.name] = store.begin(node.known_action)
            for node in nodes:
                try:
                    extractors[node.name] = _extractor(graph, node, recording, pending[node.name].out, pool)
                except Exception as err:  # noqa: BLE001  (any error costs one channel only)
                    ended[node.name] = explained_error(err, path, node.channel)
            _feed(recording, extractors, ended, channels)
            for name, extractor in extractors.items():
                if name not in ended:
                    try:
                        ended[name] = extractor.finish()
                    except Exception as err:  # noqa: BLE001  (as above)
                        ended[name] = explained_error(err, path, channels[name])
        graph.source.verify_unchanged()
    except BaseException:
        for unfinished in pending.values():
            unfinished.discard()
        raise
    return {name: _finish_channel(running, ended[name], store, path) for name, running in pending.items()}


def _extractor(
    graph: Graph, node: Node, recording: Recording, out: ArtifactWriter, pool: Executor | None
) -> ChannelExtractor:
    extract = graph.assets[node.asset].extract
    if extract is None or node.use is None:
        raise TypeError(f"{node.name} is not a channel")
    return extract(node.use, graph.inputs, recording.restrict(node.use.topics), out, pool)


def _feed(
    recording: Recording,
    extractors: Mapping[str, ChannelExtractor],
    ended: dict[str, Summary | BagAssetsError],
    channels: Mapping[str, str],
) -> None:
    """Pass each message to the extractors of its topic; an extractor that fails gets no more messages."""
    listeners: dict[str, list[tuple[str, ChannelExtractor]]] = {}
    for name, extractor in extractors.items():
        for topic in extractor.topics:
            listeners.setdefault(topic, []).append((name, extractor))
    for message in recording.messages(sorted(listeners)) if listeners else ():
        for name, extractor in listeners[message.topic]:
            if name in ended:
                continue
            try:
                extractor.add(message)
            except Exception as err:  # noqa: BLE001  (as above)
                ended[name] = explained_error(err, recording.path, channels[name])


def _finish_channel(
    running: Pending, ended: Summary | BagAssetsError, store: Store, path: Path
) -> Outcome | BagAssetsError:
    if not isinstance(ended, BagAssetsError):
        try:
            return running.commit(ended)
        except StoreError as err:  # a full disk: the other channels are kept
            return err
    running.discard()
    if not ended.transient:
        store.record_failure(running.action, str(ended), path)
    return ended
