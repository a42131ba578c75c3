"""The formats, and the assets of recordings: those of bagassets and those of installed packages.

What a package adds is checked before it is used. If something is wrong with it, it is left out, and a sentence says so;
everything else works as usual.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, fields
from functools import cache
from importlib import import_module

from bagassets.assets.annotations import ANNOTATIONS
from bagassets.assets.asset import AnyAsset
from bagassets.assets.calibration import CALIBRATION
from bagassets.assets.ego_poses import EGO_POSES
from bagassets.assets.frames import FRAMES
from bagassets.assets.inventory import INVENTORY
from bagassets.assets.preview import PREVIEW
from bagassets.assets.signal_plots import SIGNAL_PLOTS
from bagassets.assets.signals import SIGNALS
from bagassets.assets.sweeps import SWEEPS
from bagassets.base.errors import DatasetError, PluginError
from bagassets.base.plugins import ASSETS, FORMATS, Extension, installed_extensions
from bagassets.engine.build_report import SummaryRow
from bagassets.engine.recording_assets import RecordingAssets
from bagassets.formats import trajectory_map
from bagassets.formats.dataset_lock import DatasetLock
from bagassets.formats.foreign import Enabled, checked_asset, checked_format
from bagassets.formats.format import AnyFormat
from bagassets.recipe.format_settings import OUR_FORMATS
from bagassets.recipe.model import Recipe

OURS: tuple[AnyFormat, ...] = tuple(
    getattr(import_module(f"bagassets.formats.{name}.format"), name.upper()) for name in OUR_FORMATS
)
OUR_ASSETS: tuple[AnyAsset, ...] = (
    INVENTORY,
    CALIBRATION,
    EGO_POSES,
    ANNOTATIONS,
    FRAMES,
    SWEEPS,
    SIGNALS,
    *(asset for kind in OURS for asset in kind.assets),
    PREVIEW,
    SIGNAL_PLOTS,
)
_OUR_NAMES = frozenset(asset.name for asset in OUR_ASSETS)
# Names of assets in Dagster that are not assets of recordings.
_TAKEN = {"bag", "dataset_inputs", trajectory_map.STEP.name}


@dataclass(frozen=True)
class Catalogue:
    """The formats and assets in this Python environment.

    Attributes:
        formats: all formats, those of bagassets first.
        assets: assets of recordings that packages add, by name, each after those it reads.
        problems: a sentence about each format or asset that cannot be used.
    """

    formats: tuple[AnyFormat, ...]
    assets: Mapping[str, AnyAsset]
    problems: tuple[str, ...]


@cache
def catalogue() -> Catalogue:
    """Return the catalogue, as of the first call in this process."""
    problems: list[str] = []
    formats = list(OURS)
    assets: dict[str, AnyAsset] = {}
    taken = _TAKEN | {kind.asset for kind in OURS} | _OUR_NAMES

    def add(asset: object, extension: Extension) -> None:
        """Add an asset, or refuse it."""
        checked = checked_asset(asset, extension, taken)
        if checked.name in assets:
            raise extension.problem(f"{assets[checked.name].distribution} has an asset {checked.name}, too")
        counted = {name for one in (*OUR_ASSETS, *assets.values()) for name in one.face.counts}
        counted |= {field.name for field in fields(SummaryRow)}
        if clash := sorted(counted & checked.face.counts.keys()):
            raise extension.problem(f"its asset {checked.name} counts {clash[0]}, a name that is taken")
        assets[checked.name] = checked

    for extension in _single(ASSETS, problems):
        try:
            found = extension.load()
            if getattr(found, "name", None) != extension.name:
                raise extension.problem(f"{extension.reference} is not an asset of that name")
            add(found, extension)
        except PluginError as err:
            problems.append(str(err))
    for extension in _single(FORMATS, problems):
        before = dict(assets)
        try:
            kind = checked_format(extension.load(), extension, _OUR_NAMES)
            for asset in kind.assets:
                add(asset, extension)
            formats.append(kind)
        except PluginError as err:
            assets = before  # a format is used with all its assets, or not at all
            problems.append(str(err))
    assets = _in_order(assets, problems)
    formats = [kind for kind in formats if kind.part in assets or kind.part in _OUR_NAMES]
    return Catalogue(tuple(formats), assets, tuple(problems))


def _in_order(assets: Mapping[str, AnyAsset], problems: list[str]) -> dict[str, AnyAsset]:
    """Return assets of packages, each after those it reads, without those that read a missing asset."""
    ordered: dict[str, AnyAsset] = {}
    waiting = dict(assets)
    while waiting:
        there = _OUR_NAMES | ordered.keys()
        ready = [asset for asset in waiting.values() if all(one.name in there for one in asset.reads)]
        if not ready:
            break
        for asset in ready:
            ordered[asset.name] = waiting.pop(asset.name)
    for name, asset in waiting.items():
        lacking = ", ".join(one.name for one in asset.reads if one.name not in _OUR_NAMES | ordered.keys())
        problems.append(
            f"asset {name} of {asset.distribution} cannot be used: it reads {lacking}, which is not an asset of recordings here; "
            "repair, upgrade or uninstall that package."
        )
    return ordered


def known_assets() -> tuple[AnyAsset, ...]:
    """Return all assets that recordings may have except `bag`, each after those it reads."""
    return (*OUR_ASSETS, *catalogue().assets.values())


def recording_assets(recipe: Recipe) -> RecordingAssets:
    """Return the assets of recordings under a recipe."""
    return RecordingAssets(recipe, known_assets())


def formats() -> tuple[AnyFormat, ...]:
    """Return all formats, those of bagassets first."""
    return catalogue().formats


def formats_of(recipe: Recipe) -> tuple[AnyFormat, ...]:
    """Return the formats of the whole datasets of a recipe, in order; reports count the recordings of the first."""
    return tuple(kind for kind in formats() if kind.name in recipe.dataset_settings)


def installed_format(name: str) -> AnyFormat | None:
    """Return the format with a name, or None if it is not installed."""
    return next((kind for kind in formats() if kind.name == name), None)


def format_of(lock: DatasetLock) -> AnyFormat:
    """Return the format of a locked dataset.

    Raises:
        DatasetError: the format is not installed.
    """
    found = installed_format(lock.kind)
    if found is None:
        names = ", ".join(kind.name for kind in formats())
        raise DatasetError(
            f"{lock.path}: this dataset has the format {lock.kind}, which is not installed here (installed: {names}); install "
            "the package that made it."
        )
    return found


def problems_of(recipe: Recipe) -> Iterator[str]:
    """Yield a sentence about each format or asset of a package that cannot be used, in general or with this recipe."""
    yield from catalogue().problems
    for asset in catalogue().assets.values():
        if isinstance(asset.enabled, Enabled):
            yield from asset.enabled.problems(recipe)


def _single(group: str, problems: list[str]) -> Iterator[Extension]:
    """Yield the extensions of a group; two of one name are a problem, and neither is used."""
    by_name: dict[str, list[Extension]] = {}
    for extension in installed_extensions(group):
        by_name.setdefault(extension.name, []).append(extension)
    what = "format" if group == FORMATS else "asset"
    for name, found in by_name.items():
        if len(found) > 1:
            owners = " and ".join(extension.distribution for extension in found)
            problems.append(
                f"{what} {name}: {owners} both add it, so neither is used; uninstall all but one."
            )
        elif any(name == kind.name for kind in OURS) and group == FORMATS:
            problems.append(
                f"format {name}: {found[0].distribution} would replace that of bagassets; uninstall it, or give "
                "its format another name."
            )
        else:
            yield found[0]
