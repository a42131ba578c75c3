"""Asset checks per recording: what a finished asset must satisfy."""

import dagster as dg

from bagassets.defs.reporting import failures_in_words
from bagassets.defs.workspace import Workspace, recording_partitions
from bagassets.nuscenes.check import check_tables
from bagassets.nuscenes.schema import RECORDING_TABLES
from bagassets.recipe.model import Recipe

__all__ = ["recording_checks"]


def recording_checks(recipe: Recipe) -> list[dg.AssetChecksDefinition]:
    """Return the checks; they are partitioned, or one recording's pass would hide another's failure."""
    partitions = recording_partitions(recipe)

    def channels_check(asset: str) -> dg.AssetChecksDefinition:
        @dg.asset_check(
            asset=asset,
            name=f"{asset}_complete",
            partitions_def=partitions,
            description="Every message read was written or counted as lost, and every channel has readings.",
        )
        def check(context: dg.AssetCheckExecutionContext, workspace: Workspace) -> dg.AssetCheckResult:
            with failures_in_words():
                channels = workspace.artifact(context, asset).read_json("channels.json")
            empty = [name for name, entry in sorted(channels.items()) if not entry["counts"]["written"]]
            lost = {
                name: sum(entry["counts"]["lost"].values())
                for name, entry in channels.items()
                if entry["counts"]["lost"]
            }
            return dg.AssetCheckResult(
                passed=not empty,
                metadata={"channels": len(channels), "empty": ", ".join(empty) or "none", "lost": lost},
            )

        return check

    @dg.asset_check(
        asset="nuscenes_tables",
        name="tables_consistent",
        partitions_def=partitions,
        description="Every token a row refers to exists, none exists twice, chains are closed.",
    )
    def tables_consistent(
        context: dg.AssetCheckExecutionContext, workspace: Workspace
    ) -> dg.AssetCheckResult:
        with failures_in_words():
            artifact = workspace.artifact(context, "nuscenes_tables")
            tables = {name: artifact.read_json(f"{name}.json") for name in RECORDING_TABLES}
        problems = check_tables(tables)
        return dg.AssetCheckResult(
            passed=not problems,
            metadata={"problems": len(problems), "first": problems[0] if problems else "none"},
        )

    return [channels_check("frames"), channels_check("sweeps"), tables_consistent]
