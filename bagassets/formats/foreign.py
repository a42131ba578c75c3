"""Formats and assets of other packages: checked before they are used, and guarded, so that what they raise names the package."""

import re
from collections.abc import Callable, Collection, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, fields, replace
from functools import wraps
from typing import TYPE_CHECKING, ParamSpec, TypeVar, cast

from bagassets.assets.asset import AnyAsset, AnyUse, Asset, Facts, as_json
from bagassets.assets.face import Face
from bagassets.assets.quality.check import RecordingCheck
from bagassets.base.errors import BagAssetsError, DatasetError, PluginError
from bagassets.base.plugins import Extension
from bagassets.formats.format import AnyFormat, DatasetCheck, Format
from bagassets.recipe.format_settings import settings_model
from bagassets.recipe.model import Recipe, Rig
from bagassets.recipe.model_checks import Checks

if TYPE_CHECKING:
    from _typeshed import DataclassInstance

_CALLABLE = ("join", "links", "counts", "duration_s", "folder", "row", "why_empty")
_CALLABLE_OR_NONE = ("fills_split", "samples", "select", "check", "rejoin", "misfits")
_A = ParamSpec("_A")
_D = TypeVar("_D", bound="DataclassInstance")
_R = TypeVar("_R")
_T = TypeVar("_T")


def checked_format(found: object, extension: Extension, known: Collection[str]) -> AnyFormat:
    """Return a format that a package adds, guarded.

    Args:
        found: what its entry point names.
        extension: the entry point.
        known: the names of our assets, which a format may be made from.

    Raises:
        PluginError: it is not a format, or incomplete.
    """
    if not isinstance(found, Format):
        raise extension.problem(f"{extension.reference} is not a bagassets.formats.format.Format")
    if found.name != extension.name or not re.fullmatch(r"[a-z][a-z0-9_]*", str(found.name)):
        raise extension.problem(
            f"the format calls itself {found.name!r}; it must have the name of its entry point, in lower-case letters, digits and '_'"
        )
    for field in (*_CALLABLE, *_CALLABLE_OR_NONE):
        is_absent = field in _CALLABLE_OR_NONE and getattr(found, field) is None
        if not (is_absent or callable(getattr(found, field))):
            or_none = " or None" if field in _CALLABLE_OR_NONE else ""
            raise extension.problem(f"its {field} must be a function{or_none}")
    if not isinstance(found.version, int):
        raise extension.problem(f"its version must be a whole number; found {found.version!r}")
    settings_model(extension, found)
    brought = [getattr(asset, "name", None) for asset in found.assets]
    if found.part not in brought and found.part not in known:
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


def checked_asset(asset: object, extension: Extension, taken: Collection[str]) -> AnyAsset:
    """Return an asset that a package adds, guarded.

    Args:
        asset: the asset.
        extension: the entry point that brings it.
        taken: names that it must not have.

    Raises:
        PluginError: it is not one, or clashes with ours.
    """
    if not isinstance(asset, Asset):
        raise extension.problem(f"{asset!r} is not a bagassets.assets.asset.Asset")
    if (
        not re.fullmatch(r"[A-Za-z][A-Za-z0-9_]*", asset.name)
        or asset.name in taken
        or asset.name.startswith("dataset_")
    ):
        raise extension.problem(f"{asset.name!r} is not a valid name for an asset, or is taken by bagassets")
    if (asset.make is None) == (asset.extract is None):
        raise extension.problem(f"its asset {asset.name} must have either make or extract")
    if not isinstance(asset.face, Face):
        raise extension.problem(f"its asset {asset.name} has a face that is not a bagassets.assets.face.Face")
    for check in asset.checks:
        if not isinstance(check, RecordingCheck):
            raise extension.problem(f"the check {check!r} of its asset {asset.name} is not a RecordingCheck")
        _check_section(check, extension)
    return _guarded(asset, extension)


def _guarded_format(kind: AnyFormat) -> AnyFormat:
    """Return a format whose surprises cost just its own datasets."""

    def raised(what: str, said: str) -> DatasetError:
        return DatasetError(
            f"{what} of the format {kind.name} of {kind.distribution} raised {said}; fix, upgrade or uninstall that "
            "package."
        )

    guard = _Guard(raised)
    places = None if kind.places is None else guard.functions(kind.places, "places.")
    return replace(guard.functions(kind), places=places)


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

    safe = guard.functions(replace(asset, params=params, use=use))
    return replace(
        safe,
        enabled=Enabled(safe.enabled, safe.params),
        face=_guarded_face(asset.face, guard),
        checks=tuple(
            replace(check, rule=guard(check.rule, f"the check {check.name}")) for check in asset.checks
        ),
        libraries=(*asset.libraries, extension.package),
        optional=True,
        distribution=extension.distribution,
    )


def _guarded_face(face: Face, guard: "_Guard") -> Face:
    """Return a face that, where it would raise, shows what an asset without one does, and why."""

    def safe(function: Callable[[_T], _R], instead: Callable[[_T, BagAssetsError], _R]) -> Callable[[_T], _R]:
        guarded = guard(function, "the face")

        def shown(of: _T) -> _R:
            try:
                return guarded(of)
            except BagAssetsError as err:
                return instead(of, err)

        return shown

    return replace(
        face,
        shown=safe(face.shown, lambda artifact, err: {"problem": str(err), **artifact.summary()}),
        counts={name: safe(count, lambda *_: None) for name, count in face.counts.items()},
        losses=safe(lambda summary: list(face.losses(summary)), lambda *_: []),
        pictures=safe(face.pictures, lambda *_: ()),
    )


@dataclass(frozen=True)
class Enabled:
    """Whether recordings have an asset of a package: only if its parameters can be made from the recipe."""

    asked: Callable[[Recipe], bool]
    params: Callable[[Recipe, Rig], object]

    def __call__(self, recipe: Recipe) -> bool:
        """Return whether recordings have it."""
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
                found = function(*args, **options)
            return cast("_R", self._each(found, what)) if isinstance(found, Iterator) else found

        return guarded

    def functions(self, one: _D, prefix: str = "") -> _D:
        """Return an object whose functions are guarded, those in objects of its own excepted."""
        values = {field.name: getattr(one, field.name) for field in fields(one)}
        functions = {
            name: self(value, prefix + name)
            for name, value in values.items()
            if callable(value) and not isinstance(value, type)
        }
        return replace(one, **functions)

    def _each(self, found: Iterator[_T], what: str) -> Iterator[_T]:
        """Walk through what a function makes meanwhile, guarded all the way."""
        with self._guard(what):
            yield from found

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
