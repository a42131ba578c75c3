"""One sentence on what to add, where `dagster asset materialize` or `dg launch --assets` lacks a partition, or has a range.

Dagster would end them with a traceback, since runs of ours are about a recording each. It asks nobody between resolving the selection and that: so where a process of such a
command loads our definitions, the `AssetSelection` of the command's module is replaced by one that looks at what was
resolved, against all definitions of the code location. Nothing is done in any other process, for selections without
assets per recording, or if Dagster resolves selections in another way.
"""

import shlex
from collections.abc import Collection, Mapping, Sequence
from collections.abc import Set as AbstractSet
from contextlib import suppress

import click
import dagster as dg

from bagassets.base.alike import names_text
from bagassets.base.errors import BagAssetsError
from bagassets.defs.dagster_private import AssetGraph
from bagassets.defs.records.partitions import RecordingPartitions
from bagassets.recordings.discover import discover

__all__ = ["explain_missing_partition"]

_SELECTION = "AssetSelection"  # the name under which the command imports it
_SELECTING = ("select", "assets")  # options of `dagster asset materialize`, `dg launch`
_PARTITION = {"partition", "partition_range"}
_MOST_NAMED = 2
_SINGLE_RUN = dg.BackfillPolicy.single_run()


def explain_missing_partition() -> None:
    """Have the command that this process executes say what it lacks, if it is one that may lack a partition."""
    context = click.get_current_context(silent=True)
    given = {} if context is None else context.params
    selects = any(given.get(name) for name in _SELECTING)
    if not selects or not given.keys() >= _PARTITION or given["partition"]:
        return
    from bagassets.defs.dagster_private import asset  # noqa: PLC0415  (other processes have no use for it)

    setattr(asset, _SELECTION, _Selection)


class _Selection:
    """Stands in for `AssetSelection`."""

    def __init__(self, selection: dg.AssetSelection) -> None:
        self._selection = selection

    @classmethod
    def from_coercible(cls, selection: Sequence[str]) -> "_Selection":
        return cls(dg.AssetSelection.from_coercible(selection))

    def resolve(self, graph: AssetGraph) -> AbstractSet[dg.AssetKey]:
        keys = self._selection.resolve(graph)
        found = {key: graph.get(key).partitions_def for key in sorted(keys)}
        ours = {key: one for key, one in found.items() if isinstance(one, RecordingPartitions)}
        if click.get_current_context().params["partition_range"]:  # which the user's own may take
            ours = {key: one for key, one in ours.items() if graph.get(key).backfill_policy != _SINGLE_RUN}
            if ours:
                raise click.UsageError(
                    f"{_named(ours)}: made in a run per recording, so a range of partitions cannot be given; give one with "
                    "--partition KEY, or build several with `bagassets build --bag GLOB`."
                )
        elif ours:
            raise click.UsageError(_what_to_add(ours, {one for one in found.values() if one is not None}))
        return keys


def _named(keys: Collection[dg.AssetKey]) -> str:
    return names_text([key.to_user_string() for key in keys], _MOST_NAMED)


def _what_to_add(
    ours: Mapping[dg.AssetKey, RecordingPartitions], partitions: Collection[dg.PartitionsDefinition]
) -> str:
    named = _named(ours)
    if len(partitions) > 1:
        return (
            f"{named}: made per recording, and the selection has assets with other partitions, too; select those of one "
            "project, as in --select 'key:\"north/*\"', and add --partition KEY."
        )
    bags, key = next(iter(ours.values())).bags, None
    if bags is not None:
        with suppress(BagAssetsError, OSError):
            key = next(iter(discover(bags).recordings), None)
    example = f", as in --partition {shlex.quote(key)}" if key else ""
    return f"{named}: made per recording, so add --partition KEY{example}."
