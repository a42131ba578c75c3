"""The user's own assets downstream of ours: which there are, and which versions of what they would read."""

from collections.abc import Collection, Iterator, Mapping
from collections.abc import Set as AbstractSet
from dataclasses import dataclass
from functools import cache
from graphlib import TopologicalSorter

import dagster as dg

from bagassets.defs.dagster_private import AssetGraph
from bagassets.defs.graph.own_location import Locations, code_digest
from bagassets.defs.records.events import DATA_VERSION, Records
from bagassets.defs.records.naming import DATASET_INPUTS, Naming
from bagassets.defs.runs.execution import CodeLocation
from bagassets.engine.plan import is_skip
from bagassets.engine.targets import Read, Target, inputs_digest
from bagassets.formats.dataset_build import dataset_code_versions
from bagassets.recipe.model import Recipe
from bagassets.store.canonical import digest_json

FOLLOWS = "bagassets/follows"
"""Metadata of a sensor of `follow_recordings`: the asset that it runs."""
_LONGEST = 63  # characters of a tag's name


@dataclass(frozen=True, kw_only=True)
class OwnAsset(Target):
    """An asset of the user's, which has our partitions or none.

    Attributes:
        location: where it is defined.
        is_automatic: it would run by itself: it has an automation condition, or `follow_recordings` runs it.
        together: assets that are always made together, this one included.
    """

    location: CodeLocation
    is_automatic: bool
    together: frozenset[dg.AssetKey]

    @property
    def key(self) -> dg.AssetKey:
        """The key of the asset."""
        return dg.AssetKey.from_user_string(self.name)


def find_own_assets(
    locations: Locations, recipe: Recipe, names: Naming, ours: Collection[str]
) -> tuple[dict[str, OwnAsset], dict[str, str]]:
    """Return the assets downstream of ours, each after what it reads, and those that no build runs -> why."""
    own: dict[str, OwnAsset] = {}
    never: dict[str, str] = {}
    roots = {names.key(asset) for asset in (*ours, DATASET_INPUTS, *dataset_code_versions(recipe))}
    downstream = _downstream([one.asset_graph for one in locations.values()], roots)
    for location, repository in locations.items():
        graph = repository.asset_graph
        said = [sensor.metadata.get(FOLLOWS) for sensor in repository.sensor_defs]
        followed = {dg.AssetKey.from_user_string(str(key.value)) for key in said if key is not None}
        for key in downstream & graph.materializable_asset_keys:
            node, name = graph.get(key), key.to_user_string()
            is_automatic = node.automation_condition is not None or key in followed
            partitions = node.partitions_def
            is_ours = (
                isinstance(partitions, dg.DynamicPartitionsDefinition) and partitions.name == names.partitions
            )
            if partitions is None or is_ours:
                own[name] = _own_asset(graph, key, location, names, ours, is_automatic=is_automatic)
            elif is_automatic:
                never[name] = "its partitions are not the recordings"
    # Assets of one code location may read those of another.
    reads = {name: sorted({read.name for read in own[name].reads} & own.keys()) for name in sorted(own)}
    return {name: own[name] for name in TopologicalSorter(reads).static_order()}, dict(sorted(never.items()))


def _downstream(graphs: Collection[AssetGraph], roots: AbstractSet[dg.AssetKey]) -> set[dg.AssetKey]:
    """Return the assets that read some of the roots, directly or not, in whichever graph they are."""
    found, known = {*roots}, 0
    while len(found) > known:
        known = len(found)
        for graph in graphs:
            for key in graph.toposorted_asset_keys:
                if not found.isdisjoint(graph.get(key).parent_keys):
                    found.add(key)
    return found - roots


def _own_asset(
    graph: AssetGraph,
    key: dg.AssetKey,
    location: CodeLocation,
    names: Naming,
    ours: Collection[str],
    *,
    is_automatic: bool,
) -> OwnAsset:
    node = graph.get(key)
    return OwnAsset(
        key.to_user_string(),
        tuple(_reads(graph, key, names, ours)),
        node.code_version,
        node.partitions_def is not None,
        location=location,
        is_automatic=is_automatic,
        together=frozenset(node.execution_set_asset_keys) | {key},
    )


def _reads(graph: AssetGraph, key: dg.AssetKey, names: Naming, ours: Collection[str]) -> Iterator[Read]:
    is_partitioned = graph.get(key).partitions_def is not None
    for parent in sorted(graph.get(key).parent_keys - {key}):
        name, partitions = parent.to_user_string(), graph.get(parent).partitions_def
        # In a code location of its own, an asset of ours is a name without partitions.
        if partitions is None and names.asset_of(parent) not in ours:
            yield Read(name, "whole")
        elif not is_partitioned:
            yield Read(name, "all")
        else:
            mapping = graph.get_partition_mapping(key, parent) if partitions is not None else None
            is_same = mapping is None or isinstance(mapping, dg.IdentityPartitionMapping)
            yield Read(name, "same" if is_same else "all")


# --- what was read, and what would be ----------------------------------------------------


class Versions:
    """The newest versions of assets, each asked for once.

    Args:
        records: of the project.
        leaving: registered recordings whose partitions are about to be removed.
    """

    def __init__(self, records: Records, leaving: Collection[str] = ()) -> None:
        self._records, self._live = records, records.live() - frozenset(leaving)
        self._whole, self._parts = cache(self._find_whole), cache(self._find_parts)

    def of(self, read: Read, partition: str) -> str | None:
        """Return the version of something that is read; None if it was never made.

        Of all recordings it is a digest over the versions of those that are registered, and not skipped.
        """
        if read.how == "whole":
            return self._whole(read.name)
        parts = self._parts(read.name)
        if read.how == "same":
            return parts.get(partition)
        return digest_json({one: parts[one] for one in sorted(self._live & parts.keys())})

    def read_by(self, asset: Target, partition: str) -> dict[str, str]:
        """Return what an asset would read -> version, "" if that was never made."""
        return {read.name: self.of(read, partition) or "" for read in asset.reads}

    def _find_whole(self, name: str) -> str | None:
        """Return the version of an asset as it was recorded or, if nobody makes it here, observed last."""
        key = dg.AssetKey.from_user_string(name)
        newest = self._records.whole(key)
        if newest is not None:
            return newest.data_version
        for record in self._records.instance.fetch_observations(key, limit=1).records:
            if record.asset_observation is not None:
                return (record.asset_observation.tags or {}).get(DATA_VERSION)
        return None

    def _find_parts(self, name: str) -> dict[str, str]:
        tags = self._records.instance.event_log_storage.get_latest_tags_by_partition(
            dg.AssetKey.from_user_string(name), dg.DagsterEventType.ASSET_MATERIALIZATION, [DATA_VERSION]
        )
        versions = {part: found.get(DATA_VERSION, "") for part, found in tags.items()}
        return {part: one for part, one in versions.items() if not is_skip(one)}


# --- the tag of a run --------------------------------------------------------------------


def sensor_tags(
    context: dg.SensorEvaluationContext, records: Records, key: dg.AssetKey, ours: Collection[str]
) -> dict[str, str] | None:
    """Return the tag of a run of an asset that a sensor requests; None if it was made from the same, as by a build.

    The tag is empty if the definitions around the sensor are not known.
    """
    if context.repository_def is None:
        return {}
    graph = context.repository_def.asset_graph
    asset = _own_asset(graph, key, CodeLocation(), records.names, ours, is_automatic=True)
    reads = Versions(records).read_by(asset, "")
    newest = records.whole(key)
    run = None if newest is None else context.instance.get_run_by_id(newest.run_id)
    is_same = run is not None and told_inputs(run, key) == inputs_digest(asset, reads)
    return None if is_same else inputs_tag(asset, reads, code_digest())


def inputs_tag(asset: OwnAsset, reads: Mapping[str, str], code: str) -> dict[str, str]:
    """Return the tag of a run that makes an asset: digests of what it reads, and of the user's code.

    The second (`code_digest`) tells only whether a run that failed has to be tried again.
    """
    return {_tag_name(asset.key): f"{inputs_digest(asset, reads)}-{code}"}


def told_inputs(run: dg.DagsterRun, key: dg.AssetKey) -> str:
    """Return the digest of what a run has read for an asset, as its tag says; "" if it has none."""
    return run.tags.get(_tag_name(key), "").partition("-")[0]


def _tag_name(key: dg.AssetKey) -> str:
    name = ".".join(key.path)
    return f"bagassets.inputs/{name if len(name) <= _LONGEST else digest_json(list(key.path))[:32]}"
