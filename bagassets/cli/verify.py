"""`bagassets verify`: check that store and recordings are intact and that actions are reproducible."""

import math
import random
import sys
from collections.abc import Mapping, Sequence
from contextlib import suppress
from itertools import groupby
from pathlib import Path
from typing import TYPE_CHECKING

import click

from bagassets.base.alike import names_text
from bagassets.base.errors import BagAssetsError
from bagassets.base.json_types import JsonObject
from bagassets.base.quantities import count_text, readable_bytes
from bagassets.cli.exit_status import ExitStatus
from bagassets.cli.options import Number, recipe_option
from bagassets.cli.terminal import echo, echo_json, echo_lines

if TYPE_CHECKING:
    from bagassets.engine.rebuild import KnownAction
    from bagassets.engine.recording_assets import RecordingAssets
    from bagassets.engine.recordings_check import CheckedRecording
    from bagassets.engine.verified import Turns
    from bagassets.formats.dataset_integrity import DatasetDamage
    from bagassets.store.integrity import Damage

_MOST_SHOWN = 20


@click.command(
    epilog="""\b
Examples:
  bagassets verify
  bagassets verify --report-only --json
  bagassets verify --recordings
  bagassets verify --minutes 30
  bagassets verify --rebuild 20

\b
Exit status:
  0  everything is intact
  1  something is wrong with the recipe or a folder
  3  something is damaged or was not reproduced"""
)
@recipe_option
@click.option(
    "--report-only",
    is_flag=True,
    help="Leave damaged files in place; the next build will not notice them.",
)
@click.option(
    "--recordings",
    "of_recordings",
    is_flag=True,
    help="Instead of reading the store, hash every recording and name the files that do not match their digest on "
    "record, with the topics that changed. They are not written to.",
)
@click.option(
    "--rebuild",
    "number",
    type=click.IntRange(min=1),
    metavar="N",
    help="Instead of reading the store, run N random actions again, in a process with a different number of "
    "workers, different BLAS kernels and fewer processor features, and compare the results.",
)
@click.option(
    "--minutes",
    type=Number(min=0, min_open=True),
    metavar="M",
    help="Read store and recordings (with --recordings, these alone) for M minutes, what was verified longest ago first, and "
    "go on from there next time. Says how much was verified within 30 days.",
)
@click.option("--seed", type=int, help="Choose the same actions as an earlier --rebuild.")
@click.option("--json", "as_json", is_flag=True, help="Print one JSON document.")
def verify(
    recipe: Path,
    report_only: bool,
    of_recordings: bool,
    number: int | None,
    minutes: float | None,
    seed: int | None,
    as_json: bool,
) -> int:
    """Check that store and recordings are intact, and that actions are reproducible.

    Reads every file of the store and of the datasets. Artifacts with missing or changed files are removed from the
    store, and such files from the datasets: the next build makes them again.
    """
    from bagassets.engine.verified import Turns
    from bagassets.formats.catalogue import recording_assets
    from bagassets.recipe import load_recipe

    recipe = recipe.absolute()
    loaded = load_recipe(recipe)
    assets = recording_assets(loaded)
    if number is not None:
        if minutes is not None:
            raise click.UsageError("--minutes and --rebuild are two things; ask for one of them.")
        return _rebuild(recipe, assets, number, seed, as_json=as_json)
    with_recordings = of_recordings or minutes is not None
    turns = Turns(assets, with_store=not of_recordings, with_recordings=with_recordings)
    return _check(assets, turns, minutes, of_recordings, report_only=report_only, as_json=as_json)


def _check(
    assets: "RecordingAssets",
    turns: "Turns",
    minutes: float | None,
    of_recordings: bool,
    *,
    report_only: bool,
    as_json: bool,
) -> int:
    """Verify what is asked for, for some minutes or as long as it takes, and remove what is damaged."""
    from bagassets.formats.dataset_integrity import find_damage, remove_damaged
    from bagassets.store.integrity import take_out

    recipe, store = assets.recipe, assets.store
    is_all = minutes is None and not of_recordings
    damages, checked = _take_turns(turns, minutes, as_json=as_json)
    begin = "\r" if sys.stderr.isatty() else ""
    if is_all:
        click.echo(f"{begin}{count_text(len(turns.artifacts), 'artifact')} checked", err=True)
    artifacts = {d.digest for d in damages if d.kind == "artifact"}
    spoiled = list(find_damage(recipe, store, artifacts, others=is_all)) if is_all or artifacts else []
    names = _names(assets) if damages else {}
    if not report_only:
        take_out(store, damages)
        for digest in artifacts:
            del turns.artifacts[digest]
        remove_damaged(spoiled)
    wrong = sum(not recording.is_sound for recording in checked)
    status = ExitStatus.FOUND if damages or spoiled or wrong else 0
    for note in turns.notes if minutes is not None else ():
        if note.problem:
            echo(f"{note.problem}; the next run begins where this one did.", err=True)
    if as_json:
        damaged = [vars(d) | {"what": names.get(d.digest)} for d in damages]
        datasets = [{"path": str(d.path), "reason": d.reason} for d in spoiled]
        told: JsonObject = {"damaged": damaged, "datasets": datasets, "taken_out": not report_only}
        more = {"recordings": [one.as_json() for one in checked], "verified": turns.share()}
        echo_json(told if is_all else told | more)
        return status
    if damages or spoiled:
        _print_damage(damages, names, spoiled, report_only=report_only)
    elif is_all:
        echo("Store and datasets are intact.")
    if not is_all:
        size = readable_bytes(sum(recording.size for recording in checked))
        advice = " Restore them from their source; accept intended changes with `bagassets digest --rehash`."
        hashed = f"{count_text(len(checked), 'recording')}, {size} hashed: {wrong or 'none'} changed."
        echo(f"{begin}{hashed}{advice if wrong else ''}", err=True)
    if minutes is not None:
        echo(turns.share_text())
    return status


def _take_turns(
    turns: "Turns", minutes: float | None, *, as_json: bool
) -> "tuple[list[Damage], list[CheckedRecording]]":
    """Verify for some minutes, or all; return what is damaged in the store, and the recordings, which are printed meanwhile."""
    from bagassets.engine.recordings_check import CheckedRecording

    damages: list[Damage] = []
    checked: list[CheckedRecording] = []
    for number, found in enumerate(turns.run(math.inf if minutes is None else minutes * 60), 1):
        if isinstance(found, CheckedRecording):
            checked.append(found)
            if not as_json:
                _print_recording(found)
        else:
            damages += found
        if sys.stderr.isatty() and number % 50 == 0:
            click.echo(f"\r{number} checked", nl=False, err=True)
    return damages, checked


def _print_damage(
    damages: "Sequence[Damage]",
    names: Mapping[str, str],
    spoiled: "Sequence[DatasetDamage]",
    *,
    report_only: bool,
) -> None:
    for damage in damages:
        of = f" ({names[damage.digest]})" if damage.digest in names else ""
        echo(f"damaged  {damage}{of}")
    for spoiled_file in spoiled[:_MOST_SHOWN]:
        echo(f"dataset  {spoiled_file}")
    if len(spoiled) > _MOST_SHOWN:
        echo(f"dataset  and {count_text(len(spoiled) - _MOST_SHOWN, 'more file')}")
    done = "Nothing was changed." if report_only else "Removed; the next `bagassets build` makes them again."
    echo(f"Damage: {len(damages)} in the store, {len(spoiled)} in datasets. {done}", err=True)


def _print_recording(recording: "CheckedRecording") -> None:
    for file in recording.files:
        echo(f"changed  {file}")
    for topic in recording.topics:
        echo(f"           {topic}")
    if recording.files and not recording.topics and recording.problem is None:
        echo("           no topic: only an index, a header or the name of a tool changed")
    if recording.problem is not None:
        echo_lines(f"{'           ' if recording.files else 'unread   '}{recording.problem}")
    for path in recording.unrecorded:
        echo(
            f"unknown  {path}: it has no digest on record; `bagassets build` or `bagassets digest` stores one"
        )
    sys.stdout.flush()


def _names(assets: "RecordingAssets") -> dict[str, str]:
    """Return digest of artifact or action -> recording, asset and channel, as far as they are known."""
    from bagassets.engine.rebuild import known_actions

    names = {}
    with suppress(BagAssetsError):  # the bag root is gone: then there are no names
        for known in known_actions(assets):
            names[known.artifact] = names[known.action] = str(known)
    return names


def _rebuild(
    recipe_file: Path, assets: "RecordingAssets", number: int, seed: int | None, *, as_json: bool
) -> int:
    from bagassets.cli.rebuild_process import other_environment, rebuild_elsewhere
    from bagassets.engine.rebuild import known_actions

    by_action: dict[str, KnownAction] = {}
    for action in sorted(known_actions(assets)):
        by_action.setdefault(action.action, action)  # recordings with equal messages share actions
    known = list(by_action.values())
    if not known:
        raise BagAssetsError(
            f"{assets.store.root}: no action of the recordings below {assets.recipe.bags.root} is on record; run `bagassets build` first."
        )
    seed = random.SystemRandom().randrange(10**6) if seed is None else seed
    chosen = random.Random(seed).sample(known, min(number, len(known)))
    environment = other_environment()
    outcomes: list[JsonObject] = []
    for key, of_key in groupby(sorted(chosen), lambda action: action.key):
        actions = list(of_key)
        made = rebuild_elsewhere(recipe_file, key, [action.action for action in actions], environment)
        again = {result["action"]: result for result in made}
        for action in actions:
            now = again[action.action]
            outcome = {
                "result": {None: "failed", action.artifact: "same"}.get(now["artifact"], "different"),
                "recording": action.key,
                "step": action.step,
                "channel": action.channel or None,
                "action": action.action,
                "artifact": action.artifact,
                "again": now["artifact"],
                "differing": now["differing"],
                "error": now["error"],
            }
            outcomes.append(outcome)
            if not as_json:
                why = outcome["error"] or names_text(outcome["differing"])
                echo(f"{outcome['result']:<9}  {action}{': ' if why else ''}{why}")
    different = sum(outcome["result"] != "same" for outcome in outcomes)
    if as_json:
        echo_json({"seed": seed, "environment": environment, "actions": outcomes})
    else:
        how = " ".join(f"{name}={value!r}" for name, value in sorted(environment.items()))
        echo(
            f"{len(outcomes)} of {len(known)} actions run again with {how}: {len(outcomes) - different} the same, "
            f"{different} not (--seed {seed}).",
            err=True,
        )
    return ExitStatus.FOUND if different else 0
