"""What a project is called in Dagster: its asset keys, partitions, operations, jobs, sensor and resources.

A project that has its Dagster for itself needs no prefix. In somebody else's Dagster, a prefix keeps it apart from other
projects and from assets with the same names.
"""

import re
from collections.abc import Sequence
from dataclasses import dataclass

import dagster as dg

from bagassets.base.errors import RecipeError

AssetName = str | dg.AssetKey
"""An asset of the project by its name, as `frames`, or any asset by its key."""

BATCH_JOB = "build_recordings"
"""The job of runs about several recordings, without a prefix."""
BATCH_OP = "build_each"
"""Its operation."""
DATASET_INPUTS = "dataset_inputs"
"""The asset whose version says which recordings the datasets are made from."""
INPUT_PREFIX = "dagster/input_data_version/"
_POINTER_PREFIX = "dagster/input_event_pointer/"
_WORD = re.compile(r"[A-Za-z0-9_]+")
WHOLE_GRAPH = "__ASSET_JOB"
"""Dagster's job of all assets of a code location."""


@dataclass(frozen=True)
class Naming:
    """Names of one project in Dagster.

    Attributes:
        project: name of the recipe.
        prefix: what stands before the name of each asset in its key.
        group: the group of all assets; None: one for those of recordings, and one for datasets.
        resource_key: the resource that says which recipe it is; None: `workspace`, below the prefix.
    """

    project: str
    prefix: tuple[str, ...] = ()
    group: str | None = None
    resource_key: str | None = None

    def key(self, asset: AssetName) -> dg.AssetKey:
        """Return the key of an asset; one that is a key already stays what it is."""
        return asset if isinstance(asset, dg.AssetKey) else dg.AssetKey([*self.prefix, asset])

    def asset_of(self, key: dg.AssetKey) -> str | None:
        """Return the name of the asset with a key; None if the key is not below the prefix of the project."""
        *prefix, name = key.path
        return name if tuple(prefix) == self.prefix else None

    def input_tag(self, asset: str) -> str:
        """Return the tag in which a materialization says which version of an upstream asset was read."""
        return INPUT_PREFIX + self.key(asset).to_user_string()

    def pointer_tag(self, asset: str) -> str:
        """Return the tag in which it says which event that was."""
        return _POINTER_PREFIX + self.key(asset).to_user_string()

    def input_of(self, tag: str) -> str:
        """Return the upstream asset that `input_tag` is about; another project's by its whole key."""
        return self.shorten(tag.removeprefix(INPUT_PREFIX))

    def shorten(self, key: str) -> str:
        """Return the name of the asset with a key as Dagster spells it; the key itself if it is another project's."""
        return self.asset_of(dg.AssetKey.from_user_string(key)) or key

    def spell(self, name: str) -> str:
        """Return the name of an operation, a job, a sensor or a group: no two of a code location may be the same."""
        return "__".join([*self.prefix, name])  # as Dagster spells operations

    @property
    def partitions(self) -> str:
        """Name of the dynamic partitions, which is global to the Dagster instance."""
        return "/".join([*self.prefix, f"{self.project}_recordings"])

    @property
    def recording_group(self) -> str:
        """Group of the assets of a recording."""
        return self.group or self.spell("recording")

    @property
    def dataset_group(self) -> str:
        """Group of the datasets, and of what they are made from."""
        return self.group or self.spell("dataset")

    @property
    def workspace(self) -> str:
        """Key of the resource `Workspace`."""
        return self.resource_key or self.spell("workspace")

    @property
    def lock(self) -> str:
        """Key of the resource `RecordingLock`."""
        return f"{self.resource_key}_lock" if self.resource_key else self.spell("recording_lock")

    @property
    def assets_job(self) -> str:
        """The job of runs that make assets of one recording, or datasets, for the sensor."""
        return self.spell("recordings_and_datasets")

    @property
    def batch_job(self) -> str:
        """The job of runs about several recordings."""
        return self.spell(BATCH_JOB)

    @property
    def batch_op(self) -> str:
        """The operation of `batch_job`."""
        return self.spell(BATCH_OP)

    @property
    def sensor(self) -> str:
        """The sensor that requests runs."""
        return self.spell("recordings")

    def is_about(self, run: dg.DagsterRun, assets: frozenset[str]) -> bool:
        """Return whether a run makes some of these assets of the project, or may do so.

        Partition keys alone do not tell: recordings of two projects may be called the same.
        """
        if run.asset_selection:
            return any(self.asset_of(key) in assets for key in run.asset_selection)
        return run.job_name in {self.assets_job, self.batch_job, WHOLE_GRAPH}


def parse_prefix(spelled: str) -> tuple[str, ...]:
    """Return the parts of a prefix that is spelled with slashes; an empty text is none."""
    return tuple(spelled.split("/")) if spelled else ()


def checked_prefix(prefix: str | Sequence[str] | None) -> tuple[str, ...]:
    """Return the parts of a prefix.

    Raises:
        RecipeError: a part has characters that names of Dagster's operations and jobs must not have.
    """
    parts = (prefix,) if isinstance(prefix, str) else tuple(prefix or ())
    for part in parts:
        if _WORD.fullmatch(part) is None:
            raise RecipeError(
                f"key_prefix {part!r}: letters, digits and underscores were expected; for several parts, pass a list."
            )
    return parts
