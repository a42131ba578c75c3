"""`bagassets init`: a project folder from a folder of recordings."""

import os
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TypeVar

import click

from bagassets.cli.terminal import echo
from bagassets.errors import BagAssetsError, RecipeError
from bagassets.escaping import visible

__all__ = ["init"]

T = TypeVar("T")


@click.command(
    epilog="""\b
Examples:
  bagassets init my-project --bags /data/recordings
  bagassets init my-project --bags /data/recordings --force   # propose anew
  bagassets init my-project                                   # after moving the folder"""
)
@click.argument("project", type=click.Path(file_okay=False, path_type=Path))
@click.option(
    "--bags",
    type=click.Path(exists=True, file_okay=False, path_type=Path),
    metavar="DIR",
    help="Folder that holds the recordings.",
)
@click.option(
    "--look-at",
    type=click.IntRange(min=1),
    default=200,
    show_default=True,
    metavar="N",
    help="Look into at most N recordings, spread evenly over those found.",
)
@click.option("--force", is_flag=True, help="Replace the files of a project that is there already.")
def init(project: Path, bags: Path | None, look_at: int, force: bool) -> None:
    """Make a project folder, with a recipe proposed from recordings.

    Writes recipe.yaml, dagster.yaml, workspace.yaml and .env into PROJECT. The recipe is proposed
    from the first seconds of the recordings below DIR: rigs, channels, topics, frames, pose
    source, with a comment for each guess and for what could not be guessed.

    Without --bags, recipe.yaml and workspace.yaml of PROJECT are kept and the other files are
    written again, which a project needs after it was moved.
    """
    from bagassets.propose.project import FILES, write_project
    from bagassets.recipe import load_recipe

    # A link to the folder may move; where it leads, the state stays.
    project = project.resolve()
    recipe_file = project / "recipe.yaml"
    if bags is None:
        if not recipe_file.is_file():
            raise click.UsageError(
                f"{project} has no recipe.yaml yet; name the folder of the recordings with --bags."
            )
        write_project(project, None, load_recipe(recipe_file).state)
        echo(f"Rewrote dagster.yaml and .env in {project}; recipe.yaml and workspace.yaml are as they were.")
        return
    present = [name for name in FILES if (project / name).exists()]
    if present and not force:
        raise RecipeError(
            f"{project}: {', '.join(present)} would be replaced; --force does that, another folder avoids it."
        )
    write_project(project, _propose(project, bags.resolve(), look_at))
    _tell_next(project, recipe_file)


def _propose(project: Path, root: Path, look_at: int) -> str:
    """Look into the recordings below `root` and return a recipe."""
    from bagassets.propose.glance import Glance, glance
    from bagassets.propose.propose import propose
    from bagassets.recipe.model import Bags
    from bagassets.recordings.discover import discover
    from bagassets.recordings.open import open_recording

    discovery = discover(Bags(root=root))
    for sentence in discovery.unreadable.values():
        echo(f"left out: {sentence}", err=True)
    recordings = sorted(discovery.recordings.values(), key=lambda recording: recording.relative)
    if not recordings:
        raise RecipeError(
            f"{root}: no recording found; expected .bag, .mcap or .db3 files, or ROS 2 bag folders."
        )
    chosen = _spread(recordings, look_at)
    glances: dict[str, Glance] = {}
    unreadable: dict[str, str] = {}
    with click.progressbar(
        chosen,
        label=f"Looking into {len(chosen)} recording{'' if len(chosen) == 1 else 's'}",
        file=sys.stderr,
        item_show_func=lambda recording: visible(recording.relative) if recording else "",
    ) as shown:
        for recording in shown:
            try:
                with open_recording(recording) as opened:
                    glances[recording.relative] = glance(opened)
            except BagAssetsError as err:
                # The build will fail this recording's partition with the same words; others go on.
                unreadable[recording.relative] = str(err).removeprefix(f"{recording.path}: ")
    inside = root.is_relative_to(project)
    written_root = os.path.relpath(root, project) if inside else root
    return propose(
        glances, name=project.name, root=written_root, unreadable=unreadable, found=len(recordings)
    )


def _spread(items: Sequence[T], number: int) -> Sequence[T]:
    """Return `number` of the items, evenly spread from the first to the last."""
    if len(items) <= number:
        return items
    return [items[i * (len(items) - 1) // max(1, number - 1)] for i in range(number)]


def _tell_next(project: Path, recipe_file: Path) -> None:
    """Print what was proposed, what is left to decide, and the next command."""
    from bagassets.recipe import load_recipe

    echo(f"Project {project}: recipe.yaml, dagster.yaml, workspace.yaml, .env")
    text = recipe_file.read_text(encoding="utf-8")
    echo(
        f"{text.count('# guess:')} guesses and {text.count('# not guessed:')} open questions are marked in recipe.yaml; look at them first."
    )
    try:
        recipe = load_recipe(recipe_file)
    except RecipeError as err:
        echo("To be decided before the first build:")
        for line in str(err).splitlines():
            echo(f"  {line}")
    else:
        for rig in recipe.rigs:
            echo(f"  rig {rig.name}: {', '.join(rig.channels)}; poses from {rig.ego_pose.source}")
    echo("Then:")
    echo(f"  cd {project}")
    echo("  bagassets build")
