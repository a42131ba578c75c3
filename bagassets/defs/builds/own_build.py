"""Bringing the user's own assets up to date: those downstream of ours that would run by themselves, or that are asked for.

Ours come first. Then everything that can be made is made, a run per code location and partition, and so on until nothing
more can be.
"""

from collections import Counter
from collections.abc import Collection, Mapping
from dataclasses import dataclass, field, replace

import dagster as dg

from bagassets.base.quantities import count_text
from bagassets.defs.builds.own_states import OwnProject
from bagassets.defs.builds.pending_work import PendingWork
from bagassets.defs.graph.own_assets import OwnAsset, inputs_tag
from bagassets.defs.graph.own_location import code_digest
from bagassets.defs.records.batches import recordings_of
from bagassets.defs.records.partitions import ACTIVE
from bagassets.defs.runs.execution import CodeLocation
from bagassets.defs.runs.run_pool import EndedRun, Listener, RunPool
from bagassets.engine.build_report import BuildOptions, Event, OwnOutcome, OwnResult
from bagassets.engine.plan import AssetState
from bagassets.engine.targets import TO_MAKE

_SAID = {"failed", "not made", "stopped"}  # results with a reason


@dataclass
class OwnBuild:
    """Makes what is to be made.

    Attributes:
        project: the user's assets.
        options: of the build.
        on_event: called when a run begins and when it ends.
        interrupted: the user pressed Ctrl-C.
    """

    project: OwnProject
    options: BuildOptions
    on_event: Listener
    interrupted: bool = False
    _tried: dict[tuple[str, str], EndedRun | None] = field(default_factory=dict)

    def work(self, pending: PendingWork) -> OwnProject:
        """Make everything that can be made; return how it stands then.

        Args:
            pending: the state of our assets, which are up to date as far as they can be.
        """
        self._code, records = code_digest(), self.project.workspace.records
        while True:
            work = self.project.survey(pending, is_dataset_current=pending.dataset_is_current)
            to_make = work.having(*TO_MAKE)
            # Other runs are about to make some, as those of a sensor.
            runs = records.instance.get_runs(dg.RunsFilter(statuses=ACTIVE)) if to_make else ()
            keys_of = recordings_of(records, of_ours=False)
            settled = self._tried.keys() | {
                (asset.to_user_string(), partition)
                for run in runs
                for asset in run.asset_selection or ()
                for partition in keys_of(run) or ("",)
            }
            todo = [(name, partition) for name, partition, _ in to_make if (name, partition) not in settled]
            if not todo or self.interrupted:
                return work
            self._run(work, todo)

    def _run(self, work: OwnProject, todo: list[tuple[str, str]]) -> None:
        """Make some assets, those of the same partition and code location in one run."""
        self._tried |= dict.fromkeys(todo)
        assets = self.project.assets
        shared: dict[CodeLocation, dict[str, list[OwnAsset]]] = {}
        for name, partition in todo:
            by_partition = shared.setdefault(assets[name].location, {})
            by_partition.setdefault(partition, []).append(assets[name])
        counts = Counter(assets[name] for name, _ in todo)
        parts = [
            f"{asset.name} of {count_text(number, 'recording')}" if asset.is_partitioned else asset.name
            for asset, number in counts.items()
        ]
        labels = [_label(found, key) for by_key in shared.values() for key, found in by_key.items()]
        self.on_event(Event("own", sizes=dict.fromkeys(labels, 0), message=f"Then {', '.join(parts)}."))
        for location, by_partition in shared.items():
            if not self.interrupted:
                self._run_in(location, by_partition, work)

    def _run_in(
        self, location: CodeLocation, by_partition: Mapping[str, Collection[OwnAsset]], work: OwnProject
    ) -> None:
        def on_event(event: Event) -> None:
            self.on_event(replace(event, key=_label(by_partition[event.key], event.key)))

        batches: list[dict[str, tuple[str, ...]]] = []
        tags: dict[str, dict[str, str]] = {}
        for partition, assets in by_partition.items():
            keys = {key.to_user_string() for asset in assets for key in asset.together}
            batches.append({partition: tuple(sorted(keys))})
            tags[partition] = {}
            for asset in assets:
                tags[partition] |= inputs_tag(asset, work.evidence[asset.name][partition].now, self._code)
        workspace = self.project.workspace
        log, records = workspace.recipe.state / "code-server-own.log", workspace.records
        key_of = dg.AssetKey.from_user_string
        with RunPool(records, self.options.jobs, on_event, log, location, key_of, tags) as pool:
            pool.work(batches)
            self.interrupted = pool.interrupted
            for partition, ended in pool.ended.items():
                self._tried |= {(asset.name, partition): ended for asset in by_partition[partition]}

    @property
    def has_run(self) -> bool:
        """True if there were any runs."""
        return bool(self._tried)

    def outcomes(self, work: OwnProject) -> dict[str, OwnOutcome]:
        """Return what became of each asset that the build was for."""
        found = {}
        for name in self.project.wanted:
            results = {
                partition: self._outcome(name, partition, state)
                for partition, state in work.states[name].items()
            }
            found[name] = OwnOutcome(
                self.project.assets[name].is_partitioned,
                dict(Counter(result for result, _ in results.values())),
                {key: list(one) for key, one in results.items() if one[0] in _SAID},
            )
        return found

    def _outcome(self, name: str, partition: str, state: AssetState) -> tuple[OwnResult, str]:
        was_tried = (name, partition) in self._tried
        ended = self._tried.get((name, partition))
        if state.state == "fresh":
            return ("made" if was_tried else "fresh"), ""
        if state.state == "skipped":
            return "skipped", ""
        if state.state == "failed" and not was_tried:
            return "failed", f"{state.reason} (failed before; --retry-failed tries again)"
        if ended is not None and not ended.stopped and ended.problem is not None:
            return "failed", ended.problem
        if self.interrupted:
            return "stopped", "the build was interrupted; the next one carries on"
        return "not made", "another run is about to make it" if state.state in TO_MAKE else state.reason


def _label(assets: Collection[OwnAsset], partition: str) -> str:
    names = ", ".join(asset.name for asset in assets)
    return f"{names} of {partition}" if partition else names
