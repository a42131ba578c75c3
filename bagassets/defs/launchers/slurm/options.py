"""What a job asks Slurm for: from `dagster.yaml`, from rules on the size of recordings, and from the tags of a run."""

from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass, fields, replace
from typing import Self

import dagster as dg

from bagassets.base.errors import BagAssetsError
from bagassets.base.json_types import JsonMapping, JsonObject
from bagassets.defs.runs.launching import optional_fields

_TAG_PREFIX = "slurm/"
# Where a run is.
JOB_TAG, NODE_TAG, LOG_TAG = f"{_TAG_PREFIX}job", f"{_TAG_PREFIX}node", f"{_TAG_PREFIX}log"
# Whoever may launch runs may set tags, but not have a shell command executed.
_BY_TAG = ("partition", "account", "cpus", "memory", "time")
_BYTES_PER_GB = 1e9


@dataclass(frozen=True)
class JobOptions:
    """What a job asks for; empty fields are left to Slurm's defaults.

    Attributes:
        partition: Slurm's partition.
        account: account that is charged.
        cpus: processors of the job, which has as many runs side by side.
        memory: memory of the job, as `sbatch --mem` takes it.
        time: time limit, as `sbatch --time` takes it.
        options: more options of `sbatch`.
        prefix: shell text before the command, such as `module load python &&` or `apptainer exec image.sif`.
    """

    partition: str = ""
    account: str = ""
    cpus: int = 1
    memory: str = ""
    time: str = ""
    options: tuple[str, ...] = ()
    prefix: str = ""

    @classmethod
    def from_json(cls, value: JsonMapping) -> Self:
        """Inverse of `as_json`; unknown fields are ignored."""
        known = {field.name for field in fields(cls)}
        given = {name: setting for name, setting in value.items() if name in known}
        return cls(**given | {"options": tuple(given.get("options", ()))})

    def as_json(self) -> JsonObject:
        """Return the options as JSON."""
        return asdict(self) | {"options": list(self.options)}

    def changed(self, changes: JsonMapping) -> Self:
        """Return these options with some of them replaced."""
        return self.from_json(self.as_json() | dict(changes))

    def arguments(self) -> list[str]:
        """Return the options for `sbatch`."""
        named = {
            "partition": self.partition,
            "account": self.account,
            "mem": self.memory,
            "time": self.time,
            "cpus-per-task": str(self.cpus),
        }
        return [f"--{name}={value}" for name, value in named.items() if value] + list(self.options)


def options_for(
    base: JobOptions, rules: Iterable[JsonMapping], size: int, tags: Mapping[str, str]
) -> JobOptions:
    """Return the options for a run: later rules override earlier ones, and tags override all.

    Args:
        base: the options of the launcher.
        rules: its rules, as `dagster.yaml` has them: options for recordings larger than `above_gb`.
        size: bytes of the recordings that the run works on.
        tags: tags of the run.

    Raises:
        BagAssetsError: a tag has a value that it cannot have.
    """
    options = base
    for rule in rules:
        if size > rule["above_gb"] * _BYTES_PER_GB:
            options = options.changed(rule)
    for name in _BY_TAG:
        value = tags.get(f"{_TAG_PREFIX}{name}")
        if not value:
            continue
        if name != "cpus":
            options = options.changed({name: value})
        elif value.isdecimal() and int(value) > 0:
            options = replace(options, cpus=int(value))
        else:
            raise BagAssetsError(f"tag {_TAG_PREFIX}cpus: a number of processors is expected, not {value!r}.")
    return options


def options_schema() -> dict[str, dg.Field]:
    """Return the fields of the options in `dagster.yaml`."""
    texts = ("partition", "account", "memory", "time", "prefix")
    return {
        **optional_fields(dg.StringSource, *texts),
        **optional_fields(dg.IntSource, "cpus"),
        **optional_fields([str], "options"),
    }
