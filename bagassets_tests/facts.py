"""Facts of a recording that tests make up, for what an asset would read of it (`bagassets.assets.asset.Facts`)."""

from contextlib import contextmanager
from dataclasses import dataclass, field

from bagassets.base.errors import BagAssetsError
from bagassets.geometry.calibration import Calibration
from bagassets.recipe.model import Recipe


@dataclass(frozen=True)
class MadeUpArtifact:
    """An artifact of which only the digest and a few files of JSON are looked at."""

    digest: str
    files: dict = field(default_factory=dict)  # name -> content

    def read_json(self, name):
        return self.files[name]


def calibrated(**channels):
    """Return a calibration; what is not given of a channel is nothing."""
    identity = {"translation": [0.0, 0.0, 0.0], "rotation": [1.0, 0.0, 0.0, 0.0]}
    blank = {"frame": "", "ego_SE3_sensor": identity, "source": "tf_static", "camera": None}
    known = {name: {**blank, **channel} for name, channel in channels.items()}
    return Calibration.from_json({"ego_frame": "base_link", "channels": known, "notes": []})


@dataclass
class MadeUpFacts:
    inventory: object = None
    calibration: Calibration = field(default_factory=calibrated)
    artifacts: dict = field(default_factory=dict)  # asset -> artifact
    parts: dict = field(default_factory=dict)  # asset -> channel -> artifact
    label_sets: dict = field(default_factory=dict)
    definition_digests: dict = field(default_factory=dict)
    files: dict = field(default_factory=dict)  # path -> bytes
    key: str = "drive"
    format: str = "mcap"
    digest: str = "0" * 64

    def artifact(self, asset):
        return self.artifacts[asset]

    def channels(self, asset):
        return self.parts.get(asset, {})

    def labels(self, sources):
        return {entry.path: self.label_sets[entry.path] for entry in sources}

    def definitions(self, folders):
        return self.definition_digests if folders else {}

    def file(self, path):
        return self.files[path] if path in self.files else path.read_bytes()


@dataclass
class MadeUpInputs(MadeUpFacts):
    """What an action is handed; a recording only if a test has one."""

    trajectory: object = None
    recording: object = None

    @contextmanager
    def messages(self, topics):
        yield self.recording


def use_of(asset, rig, facts, channel="", **fields):
    """What an action of an asset reads of a recording, under a recipe of one rig with these `fields`.

    The error that stands in its place if it cannot be made is raised.
    """
    recipe = Recipe(name="test", bags={"root": "bags"}, rigs=(rig,), **fields)
    use = asset.use(asset.params(recipe, rig), facts)[channel]
    if isinstance(use, BagAssetsError):
        raise use
    return use
