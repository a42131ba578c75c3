"""The snapshot that a build with nothing left to do keeps for the next build."""

from collections.abc import Collection, Iterable, Sequence
from contextlib import suppress
from pathlib import Path

from bagassets.base.fingerprints import PlanNeeded, Signature, tree_lines
from bagassets.defs.records.events import event_database
from bagassets.defs.records.instance_plan import workspace_fingerprint
from bagassets.defs.records.workspace import Workspace
from bagassets.engine.build_report import Remark, remark_lines
from bagassets.engine.freshness import decide
from bagassets.engine.freshness.artifacts import folders_of
from bagassets.engine.inputs import files_beside, named_files
from bagassets.engine.plan import KeptPlan, Plan
from bagassets.formats.dataset_build import dataset_code_versions, dataset_folders
from bagassets.formats.emptiness import left_behind
from bagassets.propose.project import dagster_home
from bagassets.recipe.load import paths_written
from bagassets.recordings.join_parts import FOR_NOW
from bagassets.recordings.model import RecordingFiles


class Snapshot:
    """The fingerprints of all inputs, taken before a plan is made, and saved if the plan has nothing to do.

    So whatever changes while the plan is made differs from the snapshot, and the next build plans in full.
    """

    def __init__(self, workspace: Workspace, own_files: Sequence[str] = ()) -> None:
        self._workspace, self._recipe, instance = workspace, workspace.recipe, workspace.instance
        self._marks: dict[str, str] | None = None
        self._tree: list[str] = []
        self._folders: dict[str, Signature] = {}
        recipe_file = Path(workspace.recipe_file).absolute()
        # Where the events of assets are: the file of SQLite, or the URL of PostgreSQL; other databases have neither.
        database = event_database(instance) or getattr(instance.event_log_storage, "postgres_url", None)
        config = dagster_home(recipe_file, self._recipe) / "dagster.yaml"
        # If a variable names the database, it may be another one next time.
        if database is None or "env:" in config.read_text("utf-8"):
            return
        files, folders = named_files(self._recipe)
        # A dagster.yaml in the project folder would take precedence.
        beside = [config, recipe_file.with_name(config.name), *map(Path, own_files)]
        beside += left_behind(self._recipe)  # a remark says to remove them
        if any(rig.annotation_files for rig in self._recipe.rigs):
            # Label files may lie outside the bag root.
            recordings = workspace.discover().recordings.values()
            beside += [path for recording in recordings for path in files_beside(self._recipe, recording)]
        self._places = decide.Places(
            recipe=str(recipe_file),
            written=[str(path) for path in paths_written(recipe_file)],
            files=[str(path) for path in files],
            folders=[str(path) for path in folders],
            beside=[str(path) for path in beside],
            bag_root=str(self._recipe.bags.root),
            database=str(database),
            partitions=workspace.names.partitions,
            artifacts=str(self._recipe.store_path / "artifacts"),
        )
        self._take()

    def _take(self) -> None:
        self._marks, self._tree = None, []
        project = workspace_fingerprint(self._workspace)
        if project is not None:
            with suppress(PlanNeeded):
                self._folders = folders_of(self._places["artifacts"])
                self._tree = tree_lines(self._places["bag_root"])
                self._marks = dict(decide.fingerprints_of(self._places, project, self._tree))

    def carry_on(self, recordings: Iterable[RecordingFiles]) -> bool:
        """Take the fingerprints again; return whether nothing has changed but Dagster's records and what runs change.

        These store the digest of a recording with its files, whose time of change that changes. So the last plan holds for
        other recordings, and one of these, with all that is on record now, is one of everything.

        Args:
            recordings: that runs were about.
        """
        before, tree = self._marks, self._tree
        self._take()
        if before is None or self._marks is None:
            return False
        ours = {str(file) for recording in recordings for file in recording.files}
        may_change = {decide.RECORDS, decide.RECORDINGS}
        is_alike = all(self._marks[name] == mark for name, mark in before.items() if name not in may_change)
        return is_alike and _without_changes_of(ours, tree) == _without_changes_of(ours, self._tree)

    def save(self, plan: Plan, own: Collection[str] = (), remarks: Iterable[Remark] = ()) -> None:
        """Save the snapshot if the plan has nothing to do; else remove the last one.

        Args:
            plan: the state of our assets.
            own: the user's assets, which are up to date.
            remarks: what a build with nothing to do reports.
        """
        bags = plan.bags.values()
        is_waiting = any(FOR_NOW in reason for reason in plan.excluded.values())
        # What was noted with the plans is older, so whatever has changed since differs from it.
        made = [bag.made for bag in bags if isinstance(bag, KeptPlan)]
        if self._marks is None or is_waiting or len(made) < len(bags):
            decide.forget_note(self._recipe.state)
            return
        skipped = sum(bag.skipped is not None for bag in bags)
        counts = f"{len(plan.bags) - skipped} fresh" + (f", {skipped} skipped" if skipped else "")
        decide.note_nothing_to_do(
            self._recipe.state,
            self._places,
            [*self._marks.values()],
            folders=self._folders,
            made=made,
            published=[*dataset_code_versions(self._recipe)],
            lines=[
                *remark_lines(remarks),
                f"{counts}: nothing to do",
                *(f"dataset: {folder} (up to date)" for folder in dataset_folders(self._recipe).values()),
                *([f"{', '.join(own)}: up to date"] if own else ()),
            ],
        )


def _without_changes_of(files: Collection[str], tree: Iterable[str]) -> list[str]:
    """Return the lines of a tree, those of some files without their time of change."""
    return [line.rpartition("\0")[0] if line.partition("\0")[0] in files else line for line in tree]
