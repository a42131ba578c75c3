"""`bagassets view`: a scene of the dataset as MCAP, for Foxglove or Rerun."""

from pathlib import Path
from typing import TYPE_CHECKING

import click

from bagassets.base.escaping import visible
from bagassets.base.quantities import count_text, readable_bytes
from bagassets.cli.options import recipe_option
from bagassets.cli.terminal import echo, echo_json, echo_lines

if TYPE_CHECKING:
    from bagassets.recipe.model import Recipe


@click.command(
    epilog="""\b
Examples:
  bagassets view --list
  bagassets view monday.bag_000
  bagassets view monday.bag_000 --dataset night --output /tmp/scene.mcap
  bagassets view --dataroot /data/sets/nuscenes --version v1.0-mini scene-0061"""
)
@click.argument("scene", required=False)
@recipe_option
@click.option("--dataset", metavar="NAME", help="A named dataset of the recipe; default: the whole dataset.")
@click.option("--dataroot", type=click.Path(file_okay=False, path_type=Path), metavar="DIR",
              help="Any nuScenes dataroot, without a recipe; needs --version.")  # fmt: skip
@click.option("--version", metavar="NAME", help="Version folder in --dataroot.")
@click.option("--output", type=click.Path(dir_okay=False, path_type=Path), metavar="FILE",
              help="File to write; default: SCENE.mcap in the current folder.")  # fmt: skip
@click.option("--list", "show_list", is_flag=True, help="Print the names of all scenes instead.")
@click.option("--json", "as_json", is_flag=True, help="Print the summary, or the list, as JSON.")
def view(
    scene: str | None,
    recipe: Path,
    dataset: str | None,
    dataroot: Path | None,
    version: str | None,
    output: Path | None,
    show_list: bool,
    as_json: bool,
) -> None:
    """Write a scene of the dataset as an MCAP file with Foxglove's message types.

    SCENE is the name or token of a scene. The file holds images, point clouds, poses, boxes, transforms and the position
    on Earth; open it in Foxglove or Rerun.
    """
    from bagassets.view.scene import load_scene, scene_names

    if (dataroot is None) != (version is None):
        raise click.UsageError("--dataroot and --version go together.")
    if scene is None and not show_list:
        raise click.UsageError("name a scene, or print all names with --list.")
    settings = None
    if dataroot is None or version is None:
        from bagassets.recipe import load_recipe

        settings = load_recipe(recipe)
        dataroot, version = _place(settings, dataset)
    if show_list or scene is None:
        names = scene_names(dataroot, version)
        if as_json:
            echo_json(names)
        else:
            echo_lines("\n".join(map(visible, names)))
        return
    from bagassets.view.mcap_scene import write_scene

    chosen = load_scene(dataroot, version, scene)
    fixes = _fixes(recipe, chosen.recording) if settings is not None and chosen.origin is None else []
    path = output or Path(f"{chosen.name}.mcap")
    counts = write_scene(chosen, path, fixes)
    if as_json:
        echo_json({"file": str(path), "scene": chosen.name, "messages": counts})
        return
    echo(f"{path} ({count_text(sum(counts.values()), 'message')}, {readable_bytes(path.stat().st_size)})")
    for topic, number in counts.items():
        echo(f"{number:8d}  {topic}")


def _place(recipe: "Recipe", dataset: str | None) -> tuple[Path, str]:
    """Return dataroot and version of the whole nuScenes dataset, or of a named one."""
    from bagassets.formats.dataset_build import datasets_of
    from bagassets.formats.nuscenes.settings import NuScenes

    for one in datasets_of(recipe).values():
        name = None if one.selection is None else one.selection.name
        if name == dataset and isinstance(one.settings, NuScenes):
            return one.settings.output, one.settings.version
    if dataset is None:
        raise click.UsageError(
            "the recipe has no section `nuscenes`, and only scenes of such a dataset can be shown; add one, or name a dataset with "
            "--dataroot and --version."
        )
    known = ", ".join(named.name for named in recipe.datasets) or "none"
    raise click.UsageError(f"the recipe has no dataset {dataset}; its datasets: {known}.")


def _fixes(recipe: Path, key: str) -> list[tuple[int, float, float]]:
    """Return GNSS fixes of the recording, if the store has them."""
    from bagassets.defs.builds.pending_work import open_project
    from bagassets.defs.records.instance_plan import plan_instance
    from bagassets.engine.track import track_on_record

    with open_project(recipe) as workspace:
        bag = plan_instance(workspace).bags.get(key)
        track = None if bag is None else track_on_record(workspace.recipe, workspace.store, bag)
        return [] if track is None else list(track.points)
