"""The assets of a recording under a recipe: a list of objects, their code versions, what depends on what, and where they are kept."""

from collections.abc import Iterable, Iterator
from functools import cached_property

from bagassets.assets.asset import AnyAsset, as_json
from bagassets.base.errors import PluginError
from bagassets.base.plugins import installed_decoders
from bagassets.recipe.model import Recipe, Rig
from bagassets.recordings.digest_record import DigestIndex
from bagassets.store.canonical import digest_json
from bagassets.store.store import Store


class RecordingAssets:
    """The assets of a recording under a recipe, in the order in which they are made; `bag` is not one of them.

    Args:
        recipe: the recipe.
        known: all existing assets, each after those that it reads; those that the recipe leaves out, and those that
            read them, are dropped.

    Raises:
        PluginError: an asset comes before one that it reads, or two have the same name.
    """

    def __init__(self, recipe: Recipe, known: Iterable[AnyAsset]) -> None:
        self.recipe = recipe
        self._by_name: dict[str, AnyAsset] = {}
        self._params: dict[tuple[str, str], object] = {}
        seen: set[str] = {"bag"}
        enabled: list[AnyAsset] = []
        for asset in known:
            missing = [one.name for one in asset.reads if one.name not in seen]
            if asset.name in seen or missing:
                what = (
                    f"reads {missing[0]}, which is not an asset before it" if missing else "is defined twice"
                )
                raise PluginError(
                    f"asset {asset.name} {what}; `bagassets docs page steps` says what `bagassets.assets` takes."
                )
            seen.add(asset.name)
            if asset.enabled(recipe) and all(one.name in self._by_name for one in asset.reads):
                enabled.append(asset)
                self._by_name[asset.name] = asset
        self._enabled = tuple(enabled)
        along = {hidden.name: hidden for asset in enabled for hidden in asset.along}
        self.hidden = frozenset(along)
        self._by_name |= along

    def __iter__(self) -> Iterator[AnyAsset]:
        """Yield the assets in the order in which they are made, without those that are only made along with others."""
        return iter(self._enabled)

    def __getitem__(self, name: str) -> AnyAsset:
        """Return an asset by name, including those that are only made along with others."""
        return self._by_name[name]

    @cached_property
    def store(self) -> Store:
        """The artifact store."""
        return Store(self.recipe.store_path)

    @cached_property
    def index(self) -> DigestIndex:
        """Digests of recordings whose file system has no extended attributes."""
        return DigestIndex.of(self.recipe)

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Their names, in the order in which they are made."""
        return tuple(asset.name for asset in self)

    @cached_property
    def optional(self) -> frozenset[str]:
        """The names of the assets on which no dataset but their own depends."""
        return frozenset(asset.name for asset in self if asset.optional)

    @cached_property
    def by_channels(self) -> tuple[AnyAsset, ...]:
        """The assets in the order in which people are shown what they count: those of channels first."""
        return tuple(sorted(self, key=lambda asset: asset.extract is None))

    @property
    def counted(self) -> tuple[str, ...]:
        """What they count, such as `images`."""
        return tuple(name for asset in self.by_channels for name in asset.face.counts)

    @cached_property
    def extracted(self) -> frozenset[str]:
        """The names of the assets that one Dagster op makes together, since they read the recording itself.

        Assets that read channels come after the pass over it, and optional assets must not stop the others.
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
        """Asset -> its code version in Dagster."""
        return {asset.name: _code_version(self.recipe, asset) for asset in self}

    def version_changes(self, name: str, recorded: str | None) -> str:
        """Return which parts of the code version of an asset differ from one on record; "" if it is the same."""
        if recorded == self.versions[name]:
            return ""
        before, now = (f"{version}--".split("-") for version in (recorded or "", self.versions[name]))
        parts = "the step version", "the recipe or a library version", "the installed decoder plug-ins"
        return " and ".join(part for part, was, one in zip(parts, before, now, strict=False) if was != one)

    def upstream(self, name: str) -> tuple[str, ...]:
        """Return the names of the assets that an asset reads."""
        return tuple(asset.name for asset in self[name].reads)

    def params(self, asset: AnyAsset, rig: Rig) -> object:
        """Return the parameters of an asset for recordings of a rig."""
        key = asset.name, rig.name
        if key not in self._params:
            self._params[key] = asset.params(self.recipe, rig)
        return self._params[key]

    def with_upstream(self, names: Iterable[str]) -> tuple[str, ...]:
        """Return those of `names` that recordings have (`bag` included), and everything that they read, in order."""
        wanted: set[str] = set()
        waiting = [name for name in names if name == "bag" or name in self.names]
        while waiting:
            name = waiting.pop()
            if name not in wanted:
                wanted.add(name)
                waiting += ["bag", *self.upstream(name)] if name != "bag" else []
        return tuple(name for name in ("bag", *self.names) if name in wanted)


def _code_version(recipe: Recipe, asset: AnyAsset) -> str:
    """Return `<version>-<digest>` of an asset: of its libraries and its parameters for every rig.

    Where decoder plug-ins are installed for its messages, `-<digest>` of these follows. Which types the recordings have, the
    recipe does not say; so plug-ins for other types count, too.
    Dagster cannot see parameters; through this text a changed recipe shows in its UI as a changed code version.
    `match` decides, in order, which rig a recording belongs to: it counts where the parameters of rigs differ.
    """
    params = [as_json(asset.params(recipe, rig)) for rig in recipe.rigs]
    alike = all(one == params[0] for one in params)
    rigs = (
        params[:1]
        if alike
        else [[list(rig.match), one] for rig, one in zip(recipe.rigs, params, strict=True)]
    )
    plugins = [
        [plugin.name, plugin.as_json()]
        for family in asset.families
        for plugin in installed_decoders().plugins
        if plugin.family == family
    ]
    package = [asset.distribution] if asset.distribution else []
    # The empty list was that of plug-ins.
    version = f"{asset.version}-{digest_json([rigs, list(asset.libraries), [], *package])[:12]}"
    return f"{version}-{digest_json(plugins)[:12]}" if plugins else version
