"""The conditions of a named dataset, and which of them a scene does not meet."""

from collections.abc import Sequence
from fnmatch import fnmatchcase

from bagassets.base.alike import names_text
from bagassets.base.errors import RecipeError
from bagassets.base.json_types import JsonMapping
from bagassets.recipe.model_datasets import NamedDataset, moment_ns

__all__ = ["inside", "require_own_scenes", "unmet_condition"]

Point = Sequence[float]


def unmet_condition(
    wanted: NamedDataset, rig: str, key: str, scene: JsonMapping, former: Sequence[str] = ()
) -> str | None:
    """Return a clause about the first condition that a scene does not meet; None if it belongs to the dataset.

    Args:
        wanted: the dataset.
        rig: name of the rig that made the recording.
        key: partition key of the recording.
        scene: facts about the scene.
        former: keys that the parts of a series had alone.
    """
    if wanted.rigs and rig not in wanted.rigs:
        return f"made by rig {rig}"
    if wanted.recordings and not any(_matches(one, wanted.recordings) for one in (key, *former)):
        return "not one of the recordings"
    if wanted.scenes and not _matches(scene["name"], wanted.scenes):
        return "not one of the scenes"
    if wanted.since is not None and scene["start_ns"] < moment_ns(wanted.since):
        return f"begins before {wanted.since}"
    if wanted.until is not None and scene["start_ns"] >= moment_ns(wanted.until):
        return f"does not begin before {wanted.until}"
    if wanted.place:
        if not scene["points"]:
            return "its place is not known"
        if not any(inside(point, wanted.place) for point in scene["points"]):
            return "elsewhere"
    if wanted.daylight and scene["daylight"] not in wanted.daylight:
        return scene["daylight"] or "its daylight is not known"
    missing = [
        label for label in wanted.labels if not any(fnmatchcase(name, label) for name in scene["boxes"])
    ]
    if missing:
        return f"no {missing[0]}"
    if wanted.min_speed_mps is not None and scene["speed_mps"] < wanted.min_speed_mps:
        return f"slower than {wanted.min_speed_mps:g} m/s"
    return None


def require_own_scenes(
    wanted: NamedDataset, key: str, scenes: Sequence[JsonMapping], former: Sequence[str]
) -> None:
    """Refuse a dataset that names scenes of the parts of a drive, which has other scenes now that it is one recording.

    Args:
        wanted: the dataset.
        key: partition key of the recording.
        scenes: facts about its scenes.
        former: keys that the parts of a series had alone.

    Raises:
        RecipeError: it does.
    """
    names = [str(scene["name"]) for scene in scenes]
    for glob in wanted.scenes if names else ():
        of_part = any(fnmatchcase(f"{part}_000", glob) or glob.rpartition("_")[0] == part for part in former)
        if of_part and not any(fnmatchcase(name, glob) for name in names):
            raise RecipeError(
                f"dataset {wanted.name}: {glob} names scenes of a part of {key}, which is one recording now, with "
                f"{names_text(names)}; name some of these, or {key} in `recordings`."
            )


def inside(point: Point, polygon: Sequence[Point]) -> bool:
    """Tell whether a point lies in a polygon, by the parity of the edges on one side of the point.

    Args:
        point: latitude, longitude.
        polygon: its corners in order, the first not repeated; it may be concave, but not cross the 180th meridian.
    """
    lat, lon = point
    odd = False
    for (lat_a, lon_a), (lat_b, lon_b) in zip(polygon, [*polygon[1:], polygon[0]], strict=True):
        if (lat_a > lat) != (lat_b > lat) and lon < lon_a + (lat - lat_a) * (lon_b - lon_a) / (lat_b - lat_a):
            odd = not odd
    return odd


def _matches(name: str, globs: Sequence[str]) -> bool:
    return any(fnmatchcase(name, glob) for glob in globs)
