"""`bagassets demo`: sample drives and their dataset, with one command."""

import sys
import time
from pathlib import Path
from typing import TYPE_CHECKING

import click

from bagassets.cli.options import Number

if TYPE_CHECKING:
    from bagassets.recipe.model import Recipe
    from bagassets.sample.demo import Robot

_VERSION = "v1.0-demo"


@click.command(
    epilog="""\b
Examples:
  bagassets demo
  bagassets demo /tmp/demo --seconds 20
  bagassets demo /tmp/arm --robot arm     # ends in a LeRobot dataset

\b
Exit status: that of `bagassets build`."""
)
@click.argument("folder", type=click.Path(file_okay=False, path_type=Path), default=Path("build/demo"))
@click.option(
    "--seconds",
    type=Number(1.5, 600),  # of less there is no scene
    default=5.0,
    show_default=True,
    help="Duration of each drive.",
)
@click.option(
    "--robot",
    type=click.Choice(["car", "arm"]),
    default="car",
    show_default=True,
    help="arm: three recordings of an arm (ROS 1, ROS 2, MCAP), and their LeRobot dataset.",
)
@click.pass_context
def demo(ctx: click.Context, folder: Path, seconds: float, robot: "Robot") -> None:
    """Write sample drives and build the dataset from them.

    Writes six synthetic drives (two ROS 1, two ROS 2, two MCAP) into FOLDER/recordings, a project around them, and its
    nuScenes dataset. FOLDER defaults to build/demo. Existing files are kept: a second call only checks that everything
    is up to date.
    """
    from bagassets.base.quantities import count_text, readable_time
    from bagassets.cli.build import build
    from bagassets.cli.terminal import echo
    from bagassets.propose.project import FILES, write_project
    from bagassets.recipe import load_recipe
    from bagassets.sample.demo import missing_drives, write_drives
    from bagassets.sample.recipe import arm_recipe, sample_recipe

    folder = folder.absolute()
    recipe = folder / "recipe.yaml"
    if recipe.exists() and not _is_demo(load_recipe(recipe), robot):
        raise click.UsageError(f"{folder} holds another project; choose another folder for the demo.")
    recordings = folder / "recordings"
    missing = missing_drives(recordings, robot)
    if missing:
        began = time.monotonic()
        with click.progressbar(
            write_drives(recordings, missing, seconds, robot),
            length=len(missing),
            label=f"Writing {count_text(len(missing), 'sample drive')}, once, which takes about a minute or less",
            item_show_func=lambda name: name or "",
        ) as names:
            for number, name in enumerate(names, 1):
                if not sys.stdout.isatty():  # where there is no bar
                    echo(
                        f"wrote    {number}/{len(missing)} {name} ({readable_time(time.monotonic() - began)})"
                    )
    if not recipe.exists():
        is_arm = robot == "arm"
        write_project(
            folder, arm_recipe(name="demo") if is_arm else sample_recipe(name="demo", version=_VERSION)
        )
    elif not all((folder / name).exists() for name in FILES):
        write_project(folder, None, load_recipe(recipe).state)
    ctx.invoke(build, recipe=recipe)


def _is_demo(recipe: "Recipe", robot: "Robot") -> bool:
    """Return whether a recipe is that of the demo of a robot."""
    from bagassets.formats.nuscenes.settings import NuScenes

    if robot == "arm":
        return recipe.name == "demo" and any(rig.signals for rig in recipe.rigs)
    made_before = recipe.settings(NuScenes)
    return made_before is not None and made_before.version == _VERSION
