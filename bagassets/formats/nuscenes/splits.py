"""Names of splits in `splits.json`."""

__all__ = ["DEVKIT_SPLITS", "devkit_split_name"]

# Names that nuscenes-devkit answers itself, with the scenes of nuScenes.
DEVKIT_SPLITS = frozenset({"train", "val", "test", "mini_train", "mini_val", "train_detect", "train_track"})


def devkit_split_name(name: str) -> str:
    """Return the name of a split in `splits.json`.

    The devkit never looks up its own names there, so these get a prefix: `train` becomes `custom_train`.
    """
    return f"custom_{name}" if name in DEVKIT_SPLITS else name
