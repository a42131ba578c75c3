"""What a build and the sensor ask a run launcher beside what Dagster asks it.

Dagster's `RunLauncher` launches, cancels and looks after runs. `Launching` is the rest, with the answers of a launcher that
says nothing: so any launcher of Dagster's, or of a stranger, may stand in `dagster.yaml`. One of your own inherits
`ConfiguredLauncher` and says where it differs; no other file needs to know of it.
"""

from collections.abc import Callable, Collection
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any, Self, get_args, get_type_hints

import dagster as dg

from bagassets.base.json_types import JsonMapping
from bagassets.defs.dagster_private import (
    ConfigurableClass,
    ConfigurableClassData,
    InstanceRef,
    RunLauncher,
    T_DagsterInstance,
)
from bagassets.defs.records.databases import read_settings
from bagassets.defs.records.projects import configured_recipe
from bagassets.forkserver.server_files import last_lines

_LAST_LINES = 30
# Texts and whole numbers may be given as `{env: NAME}`.
_KINDS: dict[Any, Any] = {str: dg.StringSource, int: dg.IntSource, float: float, tuple[str, ...]: [str]}


class Launching:
    """How a launcher deals with runs.

    Attributes:
        most_at_once: most runs that a build hands over before others have ended; None: as many as it has jobs.
        recordings_per_run: most small recordings that share a run; None: as many as keep the jobs busy.
        executes_here: processes of this machine execute the runs, forked from the server that makes inventories ahead.
        names_workers: a run that it launched and that names no worker has none (see `orphaned_runs`).
    """

    most_at_once: int | None = None
    recordings_per_run: int | None = None
    executes_here: bool = False
    names_workers: bool = False

    def waiting_runs(self) -> Collection[str]:
        """Return the ids of runs that go on without the build that launched them, such as those in a cluster's queue."""
        return ()

    def end_lost_runs(self) -> list[str]:
        """Report runs that ended without anybody noticing, and return their ids; a build and the sensor ask for that."""
        return []


@dataclass(frozen=True, kw_only=True)
class LauncherSettings:
    """What `config` of a launcher in `dagster.yaml` may say; all of it has a default.

    Attributes:
        recipe: recipe of the project, for code locations that name none; default: that of the environment.
    """

    recipe: str | None = None


class ConfiguredLauncher(Launching, RunLauncher[T_DagsterInstance], ConfigurableClass):
    """A launcher with settings from `dagster.yaml`, whose runs may be checked by run monitoring.

    Args:
        inst_data: the configuration that it was made from.
        config: the fields of its settings that are given.

    Attributes:
        settings_type: a dataclass, from which Dagster learns what `config` may hold.
        settings: one of these.
    """

    settings_type: type[LauncherSettings] = LauncherSettings
    settings: LauncherSettings

    def __init__(self, inst_data: ConfigurableClassData | None = None, **config: Any) -> None:
        self._inst_data = inst_data
        self.settings = self.settings_type(**config)
        super().__init__()  # type: ignore[no-untyped-call]  # Dagster's mixin has no annotations

    @classmethod
    def config_type(cls) -> dict[str, dg.Field]:
        """Return the fields of `config` in `dagster.yaml`."""
        return config_fields(cls.settings_type)

    @property
    def inst_data(self) -> ConfigurableClassData | None:
        """Configuration that this object was made from."""
        return self._inst_data

    @classmethod
    def from_config_value(cls, inst_data: ConfigurableClassData, config_value: JsonMapping) -> Self:
        """Return the launcher that `dagster.yaml` describes."""
        arguments: dict[str, Any] = {"inst_data": inst_data, **config_value}
        return cls(**arguments)

    @property
    def supports_check_run_worker_health(self) -> bool:
        """True: run monitoring of the daemon may check."""
        return True

    @property
    def _recipe_file(self) -> Path | None:
        found = configured_recipe(self.settings.recipe)
        return None if found is None else found.absolute()

    def _refuse_to_cancel(self, run: dg.DagsterRun, why: str) -> bool:
        """Say in the log of a run why it cannot be cancelled from here; return False, as `terminate` does then."""
        message = f"The run cannot be cancelled from here, because {why}."
        self._instance.report_engine_event(message, dagster_run=run, cls=self.__class__)
        return False


def config_fields(settings: type) -> dict[str, dg.Field]:
    """Return the fields of `config` in `dagster.yaml` for a dataclass of settings; all may be left out.

    Their kinds follow from the types. Another one stands in the metadata of a field, as `kind`.
    """
    types = get_type_hints(settings)
    kinds = {
        one.name: one.metadata["kind"] if "kind" in one.metadata else _kind_of(types[one.name])
        for one in fields(settings)
    }
    return {name: dg.Field(kind, is_required=False) for name, kind in kinds.items()}


def _kind_of(hint: Any) -> Any:
    return _KINDS[hint if hint in _KINDS else get_args(hint)[0]]  # the type of `… | None`


def last_words(log: Path) -> str:
    """Return the name and the last lines of what a worker wrote; "" if it wrote nothing, or that cannot be read."""
    lines = last_lines(log, _LAST_LINES)
    return "\n".join([f"Last lines of {log}:", *lines]) if lines else ""


def launching_of(instance: dg.DagsterInstance | InstanceRef) -> Launching:
    """Return how the launcher of an instance, or of its settings, deals with runs; of one that does not say it, the defaults."""
    launcher = instance.run_launcher
    return launcher if isinstance(launcher, Launching) else Launching()


def executes_here(find_home: Callable[[], str | Path]) -> bool:
    """Return whether the fork server of this machine executes the runs, as far as that is known without opening the instance.

    Elsewhere a run has one process, or a queue packs runs, and other machines read.

    Args:
        find_home: returns the folder of the `dagster.yaml`.
    """
    try:
        return launching_of(read_settings(Path(find_home()))).executes_here
    except Exception:  # noqa: BLE001  (whatever it is, who opens the instance meets it, too, and reports it)
        return False
