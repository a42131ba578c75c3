"""`bagassets gc`: remove artifacts that nothing refers to any more."""

import time
from pathlib import Path

import click

from bagassets.base.quantities import count_text, readable_bytes
from bagassets.cli.options import Number, recipe_option
from bagassets.cli.terminal import echo, echo_json

_DAY_S = 86400.0


@click.command(
    epilog="""\b
Examples:
  bagassets gc --dry-run
  bagassets gc --keep-days 30
  bagassets gc --keep-runs-days 90            # also old runs in Dagster's database
  bagassets gc --lock releases/2026-05.lock.json --json

\b
Exit status:
  0  done
  1  something is wrong with a recipe, lock or folder, or a project that uses the store cannot be read"""
)
@recipe_option
@click.option("--dry-run", "-n", is_flag=True, help="List what would be removed, with sizes; remove nothing.")
@click.option(
    "--keep-days",
    type=Number(min=0),
    default=7.0,
    show_default=True,
    metavar="DAYS",
    help="Keep what builds made or used in the last DAYS days.",
)
@click.option(
    "--keep-runs-days",
    type=Number(min=0),
    metavar="DAYS",
    help="Also delete runs of this project from Dagster's database that ended more than DAYS days ago and that no current "
    "record is from. Default: none.",
)
@click.option(
    "--lock",
    "locks",
    multiple=True,
    type=click.Path(exists=True, dir_okay=False, path_type=Path),
    metavar="FILE",
    help="Also keep what this dataset lock refers to; may be repeated. Locks in `kept-locks` of the state folder always "
    "count.",
)
@click.option(
    "--forget",
    multiple=True,
    type=click.Path(path_type=Path),
    metavar="RECIPE",
    help="A project that used this store and no longer exists; may be repeated.",
)
@click.option("--json", "as_json", is_flag=True, help="Print one JSON document.")
def gc(
    recipe: Path,
    dry_run: bool,
    keep_days: float,
    keep_runs_days: float | None,
    locks: tuple[Path, ...],
    forget: tuple[Path, ...],
    as_json: bool,
) -> None:
    """Remove artifacts that nothing refers to any more.

    It keeps the artifacts of every dataset on disk, the current artifacts of all recordings in the Dagster instance of
    any project on this store, what recent builds made or used, and what running builds are using. Recordings are not
    looked at, so an unmounted bag root turns nothing into garbage. An artifact that is needed again is made again.

    Dagster keeps every run for ever; --keep-runs-days deletes old ones that say nothing of the present.
    """
    from bagassets.assets.track import TRACK
    from bagassets.defs.builds.garbage import find_roots
    from bagassets.defs.builds.old_runs import delete_runs, superseded_runs
    from bagassets.defs.records.events import Records
    from bagassets.defs.records.instances import open_instance
    from bagassets.defs.records.naming import Naming
    from bagassets.defs.records.projects import noted_prefix
    from bagassets.propose.project import dagster_home
    from bagassets.recipe import load_recipe
    from bagassets.store.collect import Collected, collect, find_garbage
    from bagassets.store.lease import in_use_since_s
    from bagassets.store.store import Store

    recipe = recipe.absolute()
    loaded = load_recipe(recipe)
    store = Store(loaded.store_path)
    now_s = time.time()
    running_since_s = in_use_since_s(store.root)
    used_since_s = min(now_s - keep_days * _DAY_S, now_s if running_since_s is None else running_since_s)
    kept, forgotten = (tuple(map(Path.absolute, paths)) for paths in (locks, forget))
    roots = find_roots(store, recipe, kept, forgotten)
    garbage = find_garbage(store, roots.artifacts, used_since_s, now_s, [TRACK.name])
    collected = Collected() if dry_run else collect(store, garbage, now_s)
    listed = garbage if dry_run else collected.removed
    runs: list[str] = []
    if keep_runs_days is not None:
        with open_instance(str(dagster_home(recipe, loaded))) as instance:
            records = Records(instance, Naming(loaded.name, noted_prefix(instance, recipe)))
            runs = superseded_runs(records, loaded, now_s - keep_runs_days * _DAY_S)
            if not dry_run:
                delete_runs(instance, runs)
    size = sum(entry.size for entry in listed)
    if as_json:
        artifacts = [
            {
                "artifact": entry.artifact,
                "step": entry.step or None,
                "size": entry.size,
                "unused_days": round((now_s - entry.used_s) / _DAY_S, 2),
            }
            for entry in listed
        ]
        echo_json(
            {
                "dry_run": dry_run,
                "artifacts": artifacts,
                "bytes": size,
                "runs": runs,
                "spared": collected.spared,
                "leftovers": collected.leftovers,
                "projects": [str(path) for path in roots.projects],
                "locks": [str(path) for path in roots.locks],
            }
        )
        return
    for entry in listed:
        days = (now_s - entry.used_s) / _DAY_S
        echo(
            f"{readable_bytes(entry.size):>13}  {entry.step or '(unrecorded)':<18} {entry.artifact[:16]}  "
            f"last used {days:.1f} days ago"
        )
    verb = "would be removed" if dry_run else "removed"
    echo(
        f"{count_text(len(listed), 'artifact')}, {readable_bytes(size)}, {verb}; kept what "
        f"{count_text(len(roots.projects), 'project')} and {count_text(len(roots.locks), 'dataset lock')} refer to.",
        err=True,
    )
    if keep_runs_days is not None:
        echo(f"{count_text(len(runs), 'run')} of long ago {verb} from Dagster's database.", err=True)
    if collected.spared or collected.leftovers:
        echo(
            f"{collected.spared} kept because a build uses them; {count_text(collected.leftovers, 'leftover')} of killed "
            "builds removed.",
            err=True,
        )
