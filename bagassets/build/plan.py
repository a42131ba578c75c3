"""The plan: the state of every asset of every recording, with the reason in words.

One function decides for the command line, the sensor and the status table alike. It reads
what Dagster has recorded, what the store knows and what lies on disk; it runs nothing.
"""

from collections.abc import Mapping
from dataclasses import dataclass

from bagassets.build.graph import Graph
from bagassets.build.plan_model import AssetState, BagPlan, Recorded
from bagassets.build.recording_assets import RecordingAssets
from bagassets.recordings.digest import DigestIndex, RecordingStat, stat_files, stored_digest
from bagassets.recordings.model import RecordingFiles
from bagassets.store.store import Store

__all__ = ["Planner"]


@dataclass
class Planner:
    """Decides for one recording after the other.

    Attributes:
        assets: what recordings have under the recipe.
        store: the artifact store.
        index: our own index of digests of files.
    """

    assets: RecordingAssets
    store: Store
    index: DigestIndex | None = None

    def plan(self, recording: RecordingFiles, recorded: Mapping[str, Recorded]) -> BagPlan:
        """Return the states of one recording.

        Args:
            recording: its files.
            recorded: asset -> what Dagster recorded last; nothing if its partition is not alive.
        """
        graph = self.graph(recording, recorded)
        states = graph.states()
        channels = tuple(
            part.artifact.digest
            for name in self.assets.names
            if (node := graph.node(name)).artifact is not None
            for part in node.parts
            if part.artifact is not None
        )
        on_record = {asset: record.data_version for asset, record in recorded.items()}
        rig = "" if graph.rig is None else graph.rig.name
        return BagPlan(
            recording.key, states, recording.format, on_record, channels, self.assets.optional, rig
        )

    def graph(self, recording: RecordingFiles, recorded: Mapping[str, Recorded]) -> Graph:
        """Return the graph of one recording; see `plan`."""
        digest, stat, bag = _bag_state(recording, recorded.get("bag"), self.index)
        return Graph(self.assets, self.store, recording, digest, stat, bag=bag, recorded=recorded)


def _bag_state(
    recording: RecordingFiles, recorded: Recorded | None, index: DigestIndex | None
) -> tuple[str | None, RecordingStat, AssetState]:
    stats = stat_files(recording)
    stat = RecordingStat(tuple((path.name, s.st_size, s.st_mtime_ns) for path, s in stats))
    if recorded is not None and recorded.stat == stat:
        if index is None or not any(index.suspects_edit(path, s) for path, s in stats):
            state = AssetState("fresh", "size and time unchanged", recorded.data_version)
            return recorded.data_version, stat, state
        why = "size and time unchanged, but the file was touched since"
    else:
        why = "size or time changed"
    digest = stored_digest(recording, index)
    if recorded is None:
        return digest, stat, AssetState("missing", "new recording", digest)
    if digest == recorded.data_version:
        return digest, stat, AssetState("record-only", "touched, content unchanged", digest)
    reason = f"{why}: its content has to be read" if digest is None else "content changed"
    return digest, stat, AssetState("stale", reason, digest)
