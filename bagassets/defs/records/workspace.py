"""The resource that assets and users' own steps share: recipe, store and recordings."""

from collections.abc import Callable, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any, Self, TypeVar

import dagster as dg
from pydantic import Field, PrivateAttr

from bagassets.base.errors import BagAssetsError, RecordingError, StoreError
from bagassets.base.fingerprints import recipe_fingerprint
from bagassets.defs.records.events import Records
from bagassets.defs.records.naming import AssetName, Naming
from bagassets.defs.records.projects import note_instance, note_project
from bagassets.engine.recording_assets import RecordingAssets
from bagassets.formats.catalogue import recording_assets
from bagassets.recipe import Recipe, load_recipe, where_in
from bagassets.recordings.discover import Discovery, discover
from bagassets.recordings.model import RecordingFiles
from bagassets.store.artifact import Artifact
from bagassets.store.store import Store
from bagassets.store.users import note_user

T = TypeVar("T")


class Workspace(dg.ConfigurableResource):  # type: ignore[type-arg]  # steps get it itself, not a value
    """Recipe, store and recordings, as a resource.

    An asset of your own gets it as parameter `workspace: Workspace`.
    """

    recipe_file: str
    key_prefix: list[str] = Field(default=[])
    _recipe: Recipe | None = PrivateAttr(default=None)
    _assets: RecordingAssets | None = PrivateAttr(default=None)
    _recipe_fingerprint: str = PrivateAttr(default="")
    _found_in_run: tuple[str, Any] | None = PrivateAttr(default=None)
    _instance: dg.DagsterInstance | None = PrivateAttr(default=None)

    @classmethod
    def of(cls, context: Any, resource_key: str) -> Self:
        """Return the one that a step, a check or a sensor was given, on its instance."""
        workspace: Self = getattr(context.resources, resource_key)
        return workspace.on(context.instance)

    def on(self, instance: dg.DagsterInstance | None) -> Self:
        """Return it as the project that has its records in an instance."""
        self._instance = instance
        return self

    def below(self, prefix: Sequence[str]) -> Self:
        """Return the project of the same recipe, in the same instance, below another prefix, and with the recipe as it is now."""
        return type(self)(recipe_file=self.recipe_file, key_prefix=list(prefix)).on(self._instance)

    @property
    def instance(self) -> dg.DagsterInstance:
        """The instance that has its records."""
        if self._instance is None:
            raise TypeError("a workspace without an instance has no records")
        return self._instance

    @property
    def records(self) -> Records:
        """What its instance has on record of it."""
        return Records(self.instance, self.names)

    def setup_for_execution(self, context: dg.InitResourceContext) -> None:
        """Note that the instance has this project; what to do if there is another, sensors and builds say."""
        instance, prefix = context.instance, tuple(self.key_prefix)
        if instance is not None:
            note_project(instance, prefix, Path(self.recipe_file))
            with suppress(BagAssetsError):  # a wrong recipe is reported by the step
                note_instance(instance, self.recipe.state, prefix)

    @property
    def recipe(self) -> Recipe:
        """The recipe, read once per process."""
        if self._recipe is None:
            self._recipe_fingerprint = recipe_fingerprint(self.recipe_file)
            self._recipe = load_recipe(Path(self.recipe_file))
        return self._recipe

    @property
    def names(self) -> Naming:
        """What the project is called in Dagster."""
        return Naming(self.recipe.name, tuple(self.key_prefix))

    @property
    def assets(self) -> RecordingAssets:
        """The assets of a recording under this recipe; the project is noted as a user of their store."""
        if self._assets is None:
            self._assets = recording_assets(self.recipe)
            note_user(self._assets.store.root, Path(self.recipe_file))
        return self._assets

    @property
    def recipe_fingerprint(self) -> str:
        """The fingerprint of the recipe file when it was read."""
        return self._recipe_fingerprint if self.recipe else ""

    @property
    def store(self) -> Store:
        """The artifact store."""
        return self.assets.store

    def discover(self) -> Discovery:
        """Look for recordings below the bag root (file names and sizes only).

        Raises:
            RecordingError: the root is missing (the message names the line of the recipe) or cannot be read.
        """
        root = self.recipe.bags.root
        if not root.is_dir():
            # Not checked when the recipe is read: the disk may come back, and much works without it meanwhile.
            raise RecordingError(
                f"{where_in(Path(self.recipe_file), ('bags', 'root'))}: there is no folder {root}; correct it, or mount "
                "its disk."
            )
        return discover(self.recipe.bags)

    def once_in_run(self, run_id: str, find: Callable[[], T]) -> T:
        """Return what `find` returned when it was first called in this run; a run keeps one such value."""
        if self._found_in_run is None or self._found_in_run[0] != run_id:
            self._found_in_run = run_id, find()
        return self._found_in_run[1]

    def recording(self, key: str) -> RecordingFiles:
        """Return the recording of a partition.

        Raises:
            RecordingError: there is none, or it was removed.
        """
        found = self.discover()
        if key in found.recordings:
            return found.recordings[key]
        whole = found.joined_into(key)
        where = f"it is part of {whole} now" if whole else "it was removed or renamed"
        raise RecordingError(
            f"{key}: no such recording below {self.recipe.bags.root}; {where}, and its partition is removed by the next "
            "`bagassets build` or sensor tick."
        )

    def artifact(
        self, context: dg.AssetExecutionContext | dg.AssetCheckExecutionContext, asset: AssetName
    ) -> Artifact:
        """Return the current artifact of `asset` for the partition that is being materialized.

        Args:
            context: of the step.
            asset: name of one of our assets, or the key of any.

        Raises:
            StoreError: the asset is not materialized or was skipped, or its artifact is not in the store.
        """
        key = context.partition_key
        recorded = self.on(context.instance).records.of(asset, key)
        if recorded is None or recorded.is_skip:
            name = self.names.key(asset).to_user_string()
            problem = (
                "is not materialized for this recording; materialize it first."
                if recorded is None
                else "has no artifact, as this recording is skipped; a step returns what `bagassets.defs.skipped` does."
            )
            raise StoreError(f"{key}: {name} {problem}")
        return self.store.artifact(recorded.data_version)
