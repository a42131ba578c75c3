"""The loop of a build: look at everything, decide what is next (`engine.next_steps`), do it, look again at what changed."""

import math
from collections import Counter
from collections.abc import Collection, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import replace
from typing import NoReturn

from bagassets.assets.inventory import INVENTORY
from bagassets.base.alike import names_text
from bagassets.base.errors import RecordingError
from bagassets.base.trace import span
from bagassets.defs.builds.own_states import OwnProject
from bagassets.defs.builds.pending_work import PendingWork, what_is_asked, work_of
from bagassets.defs.builds.snapshot import Snapshot
from bagassets.defs.graph.dataset import record_inputs
from bagassets.defs.records.instance_plan import planner_of, replan_instance
from bagassets.defs.records.partitions import active_runs, add_partitions, remove_partitions
from bagassets.defs.records.touched import record_touched
from bagassets.defs.runs.launching import launching_of
from bagassets.defs.runs.run_pool import EndedRun, Listener, RunPool
from bagassets.engine.batches import DATASET
from bagassets.engine.build_report import BuildOptions, Event
from bagassets.engine.disk_space import folders_written, require_disk_space, space_needed
from bagassets.engine.first_pass import ahead_of_run, was_just_made
from bagassets.engine.made_again import made_again
from bagassets.engine.next_steps import Rules, State, Work, next_steps
from bagassets.engine.unsettled import Unsettled


class BuildLoop:
    """Brings our recordings and datasets up to date.

    Args:
        own: the project, and the user's assets, which may be selected.
        options: of the build.
        on_event: called as the build goes on.

    Attributes:
        workspace: the project.
        options: of the build.
        before: the state when it began, once what was only touched had been recorded.
        now: the state when it was last looked at.
        snapshot: of what there was before everything was last looked at.
        is_partial: since then only what runs may have changed was looked at.
        unchanged: recordings of which only the time had changed -> seconds to read them.
        ended: partition key, `DATASET` for datasets -> how its last run ended.
        interrupted: the user pressed Ctrl-C.
    """

    def __init__(self, own: OwnProject, options: BuildOptions, on_event: Listener) -> None:
        self.ended: Mapping[str, EndedRun] = {}
        self.interrupted = False
        self.workspace, self._own, self.options, self._on_event = own.workspace, own, options, on_event
        self.unchanged: Mapping[str, float] = {}
        self.before = self.now = self.look(records_touched=True)

    def look_on(self, worked_on: Collection[str] = (), *, everything: bool = True) -> PendingWork:
        """Look at what runs may have changed; at everything, if anything else has changed since that was looked at.

        Args:
            worked_on: keys that runs were about since the last look.
            everything: nothing else is looked at without this.
        """
        keys = frozenset(worked_on) - {DATASET}
        self._worked_on |= keys
        self.is_partial = not everything
        if everything:
            keys, found = self._worked_on, self.now.plan.discovery.recordings
            if not self.snapshot.carry_on(found[key] for key in keys & found.keys()):
                return self.look()
        with span("plan"):
            plan = replan_instance(self.workspace, self.now.plan, keys, self._on_planned)
        self.now = work_of(self.workspace, plan, self.now.asked)
        return self.now

    def look(self, *, records_touched: bool = False) -> PendingWork:
        """Look at everything, once more if recordings of which only the time had changed are recorded first."""
        self.snapshot, self.is_partial = Snapshot(self.workspace, self._own.files), False
        self._worked_on: frozenset[str] = frozenset()
        discovery = self.workspace.discover()
        asked = what_is_asked(self.workspace, discovery, self.options, self._own)
        with span("read records"):
            planner = planner_of(self.workspace, discovery=discovery, checked="sample")
        if records_touched and asked.assets != ():
            found = planner.touched()
            chosen = {discovery.recordings[key]: found[key] for key in found if key in asked.chosen}
            self.unchanged = record_touched(self.workspace, chosen, self.options.jobs, self._on_event)
            if self.unchanged:
                return self.look()
        with span("plan"):
            plan = planner.plan(self._on_planned)
        self.now = work_of(self.workspace, plan, asked)
        return self.now

    def _on_planned(self, done: int, total: int) -> None:
        self._on_event(Event.planning(done, total))

    @property
    def has_succeeded(self) -> bool:
        """True if no run failed, and none was stopped."""
        return not self.interrupted and all(
            one.problem is None and not one.stopped for one in self.ended.values()
        )

    def work(self) -> None:
        """Do what is to be done, until nothing is left.

        Raises:
            RecordingError: all recordings are gone at once.
            StoreError: there is much too little disk space.
        """
        log, records = self.workspace.recipe.state / "code-server.log", self.workspace.records
        following = self._going_on()
        tries: Counter[str] = Counter()
        launching = launching_of(records.instance)
        rules = Rules(
            launching.most_at_once or self.options.jobs,
            launching.recordings_per_run,
            patience_s=0.0 if self.options.allow_empty else math.inf,
        )
        pool: RunPool | None = None
        with ExitStack() as stack:
            while True:
                state = self._state(tries, following)
                steps = next_steps(state, rules)
                if steps.doubted_s is not None:
                    self._refuse()
                remove_partitions(records, steps.remove)
                add_partitions(records, steps.register)
                if self.interrupted or not (steps.runs or following):
                    return
                if pool is None:
                    self._on_event(self._planned())
                    pool = stack.enter_context(
                        RunPool(records, rules.jobs, self._on_run_event, log, self._own.location)
                    )
                    self.ended = pool.ended
                pool.work(steps.runs, following, steps.without_steps)
                self.interrupted = pool.interrupted
                asked = {key for run in steps.runs for key in run} & pool.ended.keys()
                tries.update(asked)
                worked_on = asked.union(*following.values())
                self._note_unsettled(worked_on)
                # Most likely nothing is left to be done then, as only a look at everything can tell.
                if DATASET in asked and self.options.is_whole and self.has_succeeded:
                    self.look_on(worked_on)
                    return
                self.look_on(worked_on, everything=False)
                if self.now.asked.datasets and DATASET not in worked_on and not self.interrupted:
                    record_inputs(self.workspace, self.now.inputs)  # as no run has done
                following = {}

    # --- looking -------------------------------------------------------------------------

    def _state(self, tries: Mapping[str, int], following: Mapping[str, Sequence[str]]) -> State:
        """Return what `next_steps` has to know; what this build has tried once is not tried again."""
        now = self.now
        recordings, recorded = now.plan.discovery.recordings, now.plan.recorded
        todo = {
            key: Work(
                assets,
                recordings[key].size,
                is_new=INVENTORY.name not in recorded.get(key, {}),
                tries=tries[key],
            )
            for key, assets in now.todo.items()
        }
        if not now.dataset_is_current:
            todo[DATASET] = Work(now.asked.datasets, tries=tries[DATASET])
        return State(
            found=len(recordings),
            gone=now.plan.removed,
            held=now.held,
            new=recordings.keys() - now.plan.live,
            todo=todo,
            joined=() if tries[DATASET] else now.asked.datasets,
            active=frozenset().union(*following.values()),
        )

    def _going_on(self) -> dict[str, tuple[str, ...]]:
        """Return run -> keys for the runs of earlier builds that go on: those of launchers whose runs survive the build."""
        if not self.now.todo and self.now.dataset_is_current:
            return {}
        records = self.workspace.records
        waiting = launching_of(records.instance).waiting_runs()
        active = active_runs(records, self.now.asked.datasets) if waiting else {}
        return {run_id: keys for run_id, keys in active.items() if run_id in waiting}

    def _note_unsettled(self, keys: Collection[str]) -> None:
        """Note the recordings whose runs did not end well, also those of a worker that was killed."""
        unsettled = Unsettled(self.workspace.recipe.state)
        noted = unsettled.noted()  # of most recordings nothing is: their worker has seen to it
        for key in frozenset(keys) & self.ended.keys() - {DATASET}:
            one = self.ended[key]
            if one.run_id and (one.problem is not None or one.stopped):
                unsettled.add(key)
            elif one.run_id and key in noted:
                unsettled.discard(key)

    # --- telling -------------------------------------------------------------------------

    def _on_run_event(self, event: Event) -> None:
        """Say of a recording that was made ahead of its run that the run took only the rest of the time."""
        if event.kind == "done" and was_just_made(self.workspace.recipe.state, ahead_of_run(event.key)):
            event = replace(event, message="made ahead")
        self._on_event(event)

    def _planned(self) -> Event:
        """Return the event that says what is going to be done.

        Raises:
            StoreError: there is much too little disk space.
        """
        now, assets = self.now, self.workspace.assets
        sizes = {key: one.size for key, one in now.plan.discovery.recordings.items()}
        said = [
            f"{names_text(keys)}: joined into {whole}, as its parts."
            for whole, keys in now.plan.joined.items()
        ]
        said.append(made_again(assets, now.plan, now.todo, self.options.jobs))
        needed = space_needed(now.plan, sizes, now.todo, assets)
        if needed is not None:
            folders = folders_written(assets.store.root, assets.recipe)
            said.append(require_disk_space(needed, folders, ignore=self.options.ignore_disk_space))
        message = "\n".join(filter(None, said))
        return Event("planned", sizes={key: sizes[key] for key in now.todo}, message=message)

    def _refuse(self) -> NoReturn:
        """Refuse an empty bag root where there were recordings: a disk may not be mounted."""
        gone = len(self.now.plan.removed)
        recordings = "the recording that was" if gone == 1 else f"all {gone} recordings that were"
        subject = "it is" if gone == 1 else "they are"
        raise RecordingError(
            f"{self.workspace.recipe.bags.root}: {recordings} here before cannot be found; is the disk mounted, and are "
            f"bags.include and bags.exclude right? If {subject} gone for good, use --allow-empty."
        )
