"""The assets that recordings have under a recipe: a list of objects, and what follows from it."""

from collections.abc import Iterable, Iterator
from functools import cached_property
from typing import Any

from bagassets.assets.asset import AnyAsset
from bagassets.build.code_version import code_version
from bagassets.errors import PluginError
from bagassets.recipe.model import Recipe, Rig

__all__ = ["RecordingAssets"]


class RecordingAssets:
    """The assets that recordings have under a recipe, in the order in which they are made; `bag` is none of them.

    Args:
        recipe: the recipe.
        known: all assets that there are, each after those that it reads; those that the recipe leaves out, and
            what reads them, are none of its recordings'.

    Raises:
        PluginError: an asset stands before one that it reads, or two have the same name.
    """

    def __init__(self, recipe: Recipe, known: Iterable[AnyAsset]) -> None:
        self.recipe = recipe
        self._by_name: dict[str, AnyAsset] = {}
        self._params: dict[tuple[str, str], Any] = {}
        seen: set[str] = {"bag"}
        enabled: list[AnyAsset] = []
        for asset in known:
            missing = [one.name for one in asset.reads if one.name not in seen]
            if asset.name in seen or missing:
                what = f"reads {missing[0]}, which is no asset before it" if missing else "is there twice"
                raise PluginError(f"asset {asset.name} {what}; see `bagassets.assets` in docs/steps.md.")
            seen.add(asset.name)
            if asset.enabled(recipe) and all(one.name in self._by_name for one in asset.reads):
                enabled.append(asset)
                self._by_name[asset.name] = asset
        self._enabled = tuple(enabled)
        along = {hidden.name: hidden for asset in enabled for hidden in asset.along}
        self.hidden = frozenset(along)
        self._by_name |= along

    def __iter__(self) -> Iterator[AnyAsset]:
        """Yield them in the order in which they are made; not those that are only made along with others."""
        return iter(self._enabled)

    def __getitem__(self, name: str) -> AnyAsset:
        """Return an asset, or what is made along with one, by name."""
        return self._by_name[name]

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Their names, in the order in which they are made."""
        return tuple(asset.name for asset in self)

    @cached_property
    def optional(self) -> frozenset[str]:
        """The names of those that no dataset but their own depends on."""
        return frozenset(asset.name for asset in self if asset.optional)

    @cached_property
    def extracted(self) -> frozenset[str]:
        """The names of those that one operation of Dagster makes together, since they read the recording itself.

        What reads channels comes after the pass over it, and what no dataset depends on must not stop the others.
        """
        after = {asset.name for asset in self if asset.extract is not None}
        extracted = set()
        for asset in self:
            if any(one.name in after for one in asset.reads):
                after.add(asset.name)
            elif not asset.optional:
                extracted.add(asset.name)
        return frozenset(extracted)

    @cached_property
    def versions(self) -> dict[str, str]:
        """Asset -> Dagster's code version of it."""
        return {asset.name: code_version(self.recipe, asset) for asset in self}

    def upstream(self, name: str) -> tuple[str, ...]:
        """Return the names of the assets that an asset reads."""
        return tuple(asset.name for asset in self[name].reads)

    def params(self, asset: AnyAsset, rig: Rig) -> Any:
        """Return what an asset may know of the recipe for recordings of a rig."""
        key = asset.name, rig.name
        if key not in self._params:
            self._params[key] = asset.params(self.recipe, rig)
        return self._params[key]

    def with_upstream(self, names: Iterable[str]) -> tuple[str, ...]:
        """Return those of `names` that recordings have (`bag` among them), and everything that they read, in order."""
        wanted: set[str] = set()
        waiting = [name for name in names if name == "bag" or name in self.names]
        while waiting:
            name = waiting.pop()
            if name not in wanted:
                wanted.add(name)
                waiting += ["bag", *self.upstream(name)] if name != "bag" else []
        return tuple(name for name in ("bag", *self.names) if name in wanted)
