"""What a job asks Slurm for: from `dagster.yaml`, from rules on the size of recordings, and from the tags of a run."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, fields

from bagassets.base.errors import BagAssetsError
from bagassets.base.json_types import JsonMapping, JsonObject

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
    def from_json(cls, value: JsonMapping) -> "JobOptions":
        """Inverse of `as_json`."""
        return JobOptions(**{**value, "options": tuple(value["options"])})

    def as_json(self) -> JsonObject:
        """Return the options as JSON, without what a launcher has beside them."""
        return {one.name: getattr(self, one.name) for one in fields(JobOptions)} | {
            "options": [*self.options]
        }

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
    options = base.as_json()
    for rule in rules:
        if size > rule["above_gb"] * _BYTES_PER_GB:
            options |= {name: value for name, value in rule.items() if name in options}
    for name in _BY_TAG:
        value = tags.get(f"{_TAG_PREFIX}{name}")
        if not value:
            continue
        if name == "cpus" and not (value.isdecimal() and int(value) > 0):
            raise BagAssetsError(f"tag {_TAG_PREFIX}cpus: a number of processors is expected, not {value!r}.")
        options[name] = int(value) if name == "cpus" else value
    return JobOptions.from_json(options)
