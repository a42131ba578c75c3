"""Actions: executions of a step, named by a digest of everything that shapes their bytes."""

from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from functools import cache, cached_property
from importlib.metadata import PackageNotFoundError, version

from bagassets.base.json_types import JsonMapping, JsonObject
from bagassets.store.canonical import digest_json


@cache
def _version(name: str) -> str:
    """Return the version of a distribution; "" for one of an extra that is not installed, without which no action is planned."""
    try:
        return version(name)
    except PackageNotFoundError:
        return ""


@dataclass(frozen=True)
class Step:
    """A kind of action.

    Attributes:
        name: step name, stable for ever.
        version: raised whenever the step's bytes change; a golden test guards it.
        libraries: distributions whose version shapes the bytes.
    """

    name: str
    version: int
    libraries: tuple[str, ...] = ()

    def action(self, params: JsonMapping, inputs: Mapping[str, str]) -> "Action":
        """Return the action of this step with `params` (JSON) on `inputs` (name -> digest)."""
        libraries = {name: _version(name) for name in self.libraries}
        return Action(self.name, self.version, libraries, dict(params), dict(inputs))


@dataclass(frozen=True)
class Action:
    """One execution of a step, known before it runs."""

    step: str
    version: int
    libraries: Mapping[str, str] = field(default_factory=dict)
    params: JsonMapping = field(default_factory=dict)
    inputs: Mapping[str, str] = field(default_factory=dict)

    def as_json(self) -> JsonObject:
        """Return the action as JSON, from which its digest is computed."""
        return {one.name: getattr(self, one.name) for one in fields(self)}

    @cached_property
    def digest(self) -> str:
        """Digest of the action."""
        return digest_json(self.as_json())
