"""Files that steps read besides the recordings: the recipe names them, or they lie beside a recording."""

from pathlib import Path

from bagassets.annotations.files.find import label_paths
from bagassets.assets.selection import choose_rig
from bagassets.recipe.model import Recipe
from bagassets.recordings.model import RecordingFiles

__all__ = ["files_beside", "named_files"]


def named_files(recipe: Recipe) -> tuple[list[Path], list[Path]]:
    """Return the URDF and calibration files and the folders of message definitions that a recipe names, if they exist or not."""
    files = [rig.urdf for rig in recipe.rigs if rig.urdf is not None]
    channels = [channel for rig in recipe.rigs for channel in rig.channels.values()]
    files += [one.file for channel in channels for one in channel.calibration_files.values()]
    return list(dict.fromkeys(files)), list(recipe.bags.message_definitions)


def files_beside(recipe: Recipe, recording: RecordingFiles) -> list[Path]:
    """Return the paths of a recording's label files, and the paths where some might appear."""
    if not any(rig.annotation_files for rig in recipe.rigs):
        return []
    rig = choose_rig(recipe, *recording.names)
    return [] if rig is None else label_paths(rig, recording)
