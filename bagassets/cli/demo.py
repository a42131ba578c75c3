"""`bagassets demo`: sample drives and their dataset, with one command."""

import sys
import time
from pathlib import Path

import click

_VERSION = "v1.0-demo"


@click.command(
    epilog="""\b
Examples:
  bagassets demo
  bagassets demo /tmp/demo --seconds 20

\b
Exit status: that of `bagassets build`."""
)
@click.argument("folder", type=click.Path(file_okay=False, path_type=Path), default=Path("build/demo"))
@click.option(
    "--seconds",
    type=click.FloatRange(1.5, 600),  # of less there is no scene
    default=5.0,
    show_default=True,
    help="Duration of each drive.",
)
@click.pass_context
def demo(ctx: click.Context, folder: Path, seconds: float) -> None:
    """Write sample drives and build the dataset from them.

    Writes six synthetic drives (two ROS 1, two ROS 2, two MCAP) into FOLDER/recordings, a project around them, and its
    nuScenes dataset. FOLDER defaults to build/demo. Existing files are kept: a second call only checks that everything
    is up to date.
    """
    from bagassets.base.quantities import count_text, readable_time
    from bagassets.cli.build import build
    from bagassets.cli.terminal import echo
    from bagassets.formats.nuscenes.settings import NuScenes
    from bagassets.propose.project import FILES, write_project
    from bagassets.recipe import load_recipe
    from bagassets.sample.demo import missing_drives, write_drives
    from bagassets.sample.recipe import sample_recipe

    folder = folder.absolute()
    recipe = folder / "recipe.yaml"
    made_before = load_recipe(recipe).settings(NuScenes) if recipe.exists() else NuScenes(version=_VERSION)
    if made_before is None or made_before.version != _VERSION:
        raise click.UsageError(f"{folder} holds another project; choose another folder for the demo.")
    recordings = folder / "recordings"
    missing = missing_drives(recordings)
    if missing:
        began = time.monotonic()
        with click.progressbar(
            write_drives(recordings, missing, seconds),
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
        write_project(folder, sample_recipe(name="demo", version=_VERSION))
    elif not all((folder / name).exists() for name in FILES):
        write_project(folder, None, load_recipe(recipe).state)
    ctx.invoke(build, recipe=recipe)
