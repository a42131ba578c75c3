"""The formats, and the assets of recordings: those of bagassets and those of installed packages.

What a package adds is checked before it is used. If something is wrong with it, it is left out, and a sentence says so;
everything else works as usual.
"""

import re
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import cache, wraps
from importlib import import_module
from typing import Any, ParamSpec, TypeVar

from bagassets.assets.annotations import ANNOTATIONS
from bagassets.assets.asset import AnyAsset, AnyUse, Asset, Facts, as_json
from bagassets.assets.calibration import CALIBRATION
from bagassets.assets.ego_poses import EGO_POSES
from bagassets.assets.frames import FRAMES
from bagassets.assets.inventory import INVENTORY
from bagassets.assets.preview import PREVIEW
from bagassets.assets.quality.check import RecordingCheck
from bagassets.assets.sweeps import SWEEPS
from bagassets.base.errors import BagAssetsError, DatasetError, PluginError
from bagassets.base.extensions import ASSETS, FORMATS, Extension, installed_extensions
from bagassets.engine.recording_assets import RecordingAssets
from bagassets.formats.dataset_lock import DatasetLock
from bagassets.formats.format import AnyFormat, DatasetCheck, Format, LooseFiles, UnitFolders
from bagassets.recipe.format_settings import OUR_FORMATS, settings_model
from bagassets.recipe.model import Recipe, Rig
from bagassets.recipe.model_checks import Checks

__all__ = [
    "Catalogue",
    "catalogue",
    "format_of",
    "formats",
    "formats_of",
    "installed_format",
    "known_assets",
    "problems_of",
    "recording_assets",
]

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
    *(asset for kind in OURS for asset in kind.assets),
    PREVIEW,
)
_OUR_NAMES = frozenset(asset.name for asset in OUR_ASSETS)
_CALLABLE = ("join", "links", "counts", "duration_s", "folder", "row", "why_empty")
_CALLABLE_OR_NONE = ("fills_split", "samples", "select", "check")
# Names of assets in Dagster that are not assets of recordings.
_TAKEN = {"bag", "dataset_inputs", "trajectory_map"}
_A = ParamSpec("_A")
_R = TypeVar("_R")


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

    def add(asset: object, extension: Extension) -> None:
        """Add an asset, or refuse it."""
        checked = _checked_asset(asset, extension)
        if checked.name in assets:
            raise extension.problem(f"{assets[checked.name].distribution} has an asset {checked.name}, too")
        assets[checked.name] = _guarded(checked, extension)

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
            kind = _checked_format(extension.load(), extension)
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
        if isinstance(asset.enabled, _Enabled):
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


def _checked_format(found: object, extension: Extension) -> AnyFormat:
    """Return a format that a package adds.

    Raises:
        PluginError: it is not a format, or incomplete.
    """
    if not isinstance(found, Format):
        raise extension.problem(f"{extension.reference} is not a bagassets.formats.format.Format")
    if found.name != extension.name or not re.fullmatch(r"[a-z][a-z0-9_]*", str(found.name)):
        raise extension.problem(
            f"the format calls itself {found.name!r}; it must have the name of its entry point, in lower-case letters, digits and '_'"
        )
    for field in _CALLABLE:
        if not callable(getattr(found, field)):
            raise extension.problem(f"its {field} must be a function")
    for field in _CALLABLE_OR_NONE:
        if getattr(found, field) is not None and not callable(getattr(found, field)):
            raise extension.problem(f"its {field} must be a function or None")
    if not isinstance(found.version, int):
        raise extension.problem(f"its version must be a whole number; found {found.version!r}")
    settings_model(extension, found)
    brought = [getattr(asset, "name", None) for asset in found.assets]
    if found.part not in brought and found.part not in _OUR_NAMES:
        raise extension.problem(
            f"its part {found.part!r} is not one of its assets ({', '.join(map(str, brought)) or 'none'})"
        )
    for check in found.checks:
        _check_section(check, extension)
    if bool(found.checks) != (found.check is not None):
        raise extension.problem("it must have both checks and check, or neither")
    return _guarded_format(replace(found, distribution=extension.distribution))


def _check_section(check: DatasetCheck | RecordingCheck, extension: Extension) -> None:
    """Refuse a check whose severity is not a field of the recipe."""
    if check.section not in Checks.model_fields.keys() - {"enabled"}:
        raise extension.problem(
            f"its check {check.name} has the section {check.section!r}, which is not in `checks` of the recipe"
        )


def _checked_asset(asset: object, extension: Extension) -> AnyAsset:
    """Return an asset that a package adds.

    Raises:
        PluginError: it is not one, or clashes with ours.
    """
    if not isinstance(asset, Asset):
        raise extension.problem(f"{asset!r} is not a bagassets.assets.asset.Asset")
    taken = _TAKEN | {kind.asset for kind in OURS} | _OUR_NAMES
    if (
        not re.fullmatch(r"[A-Za-z][A-Za-z0-9_]*", asset.name)
        or asset.name in taken
        or asset.name.startswith("dataset_")
    ):
        raise extension.problem(f"{asset.name!r} is not a valid name for an asset, or is taken by bagassets")
    if (asset.make is None) == (asset.extract is None):
        raise extension.problem(f"its asset {asset.name} must have either make or extract")
    for check in asset.checks:
        if not isinstance(check, RecordingCheck):
            raise extension.problem(f"the check {check!r} of its asset {asset.name} is not a RecordingCheck")
        _check_section(check, extension)
    return asset


def _guarded_format(kind: AnyFormat) -> AnyFormat:
    """Return a format of a package whose surprises cost just its own datasets."""

    def raised(what: str, said: str) -> DatasetError:
        return DatasetError(
            f"{what} of the format {kind.name} of {kind.distribution} raised {said}; fix, upgrade or uninstall that "
            "package."
        )

    guard = _Guard(raised)
    places = kind.places
    if isinstance(places, UnitFolders):
        places = replace(places, name=guard(places.name, "places.name"))
    elif isinstance(places, LooseFiles):
        places = LooseFiles(
            guard.each(places.named_in, "places.named_in"), guard(places.recording_of, "places.recording_of")
        )
    safe: dict[str, Any] = {}
    for field in (*_CALLABLE, *_CALLABLE_OR_NONE):
        function = getattr(kind, field)
        safe[field] = None if function is None else guard(function, field)
    safe["links"] = guard.each(kind.links, "links")
    return replace(kind, places=places, **safe)


def _guarded(asset: AnyAsset, extension: Extension) -> AnyAsset:
    """Return an asset whose exceptions name its package, and whose action includes the package's version."""

    def raised(what: str, reason: str) -> PluginError:
        return extension.problem(f"{what} of its asset {asset.name} raised {reason}")

    guard = _Guard(raised)

    def params(recipe: Recipe, rig: Rig) -> object:
        found = asset.params(recipe, rig)
        as_json(found)  # raises without a normal form
        return found

    def use(params: object, facts: Facts) -> Mapping[str, AnyUse | Exception]:
        uses = asset.use(params, facts)
        return {
            channel: guard.explained(one, "use") if isinstance(one, Exception) else one
            for channel, one in uses.items()
        }

    safe = guard(params, "params")
    return replace(
        asset,
        enabled=_Enabled(guard(asset.enabled, "enabled"), safe),
        params=safe,
        use=guard(use, "use"),
        make=None if asset.make is None else guard(asset.make, "make"),
        extract=None if asset.extract is None else guard(asset.extract, "extract"),
        checks=tuple(
            replace(check, rule=guard(check.rule, f"the check {check.name}")) for check in asset.checks
        ),
        waits_for=None if asset.waits_for is None else guard(asset.waits_for, "waits_for"),
        libraries=(*asset.libraries, extension.package),
        optional=True,
        distribution=extension.distribution,
    )


@dataclass(frozen=True)
class _Enabled:
    """Whether recordings have an asset of a package: only if its parameters can be made from the recipe."""

    asked: Callable[[Recipe], bool]
    params: Callable[[Recipe, Rig], object]

    def __call__(self, recipe: Recipe) -> bool:
        return not any(self.problems(recipe)) and self.asked(recipe)

    def problems(self, recipe: Recipe) -> Iterator[str]:
        """Yield a sentence if the asset cannot be planned with a recipe."""
        try:
            if self.asked(recipe):
                for rig in recipe.rigs:
                    self.params(recipe, rig)
        except BagAssetsError as err:
            yield str(err)


class _Guard:
    """Turns whatever a function of a package raises into a sentence that names the package.

    Args:
        raised: returns the error for a function's name, and for what it raised.
    """

    def __init__(self, raised: Callable[[str, str], BagAssetsError]) -> None:
        self._raised = raised

    def __call__(self, function: Callable[_A, _R], what: str) -> Callable[_A, _R]:
        """Return the function, guarded."""

        @wraps(function)
        def guarded(*args: _A.args, **options: _A.kwargs) -> _R:
            with self._guard(what):
                return function(*args, **options)

        return guarded

    def each(self, function: Callable[_A, Iterable[_R]], what: str) -> Callable[_A, Iterator[_R]]:
        """Return a function whose result is made while it is walked through, guarded all the way."""

        @wraps(function)
        def guarded(*args: _A.args, **options: _A.kwargs) -> Iterator[_R]:
            with self._guard(what):
                yield from function(*args, **options)

        return guarded

    def explained(self, err: Exception, what: str) -> BagAssetsError:
        """Return an error of ours as it is, and any other as one that names the package."""
        if isinstance(err, BagAssetsError):
            return err
        explained = self._raised(what, f"{type(err).__name__}: {err}")
        explained.__cause__ = err
        return explained

    @contextmanager
    def _guard(self, what: str) -> Iterator[None]:
        try:
            yield
        except BagAssetsError:
            raise
        except Exception as err:
            raise self.explained(err, what) from err
