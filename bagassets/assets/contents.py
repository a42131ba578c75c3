"""What the artifacts of a recording hold that is read most."""

from abc import ABC, abstractmethod
from functools import cached_property

from bagassets.assets.calibration import CALIBRATION
from bagassets.assets.ego_poses import EGO_POSES, load_trajectory
from bagassets.assets.inventory import INVENTORY
from bagassets.geometry.calibration import Calibration
from bagassets.geometry.trajectory import Trajectory
from bagassets.recordings.inventory import Inventory
from bagassets.recordings.pack import PACK_FILE, Pack
from bagassets.store.artifact import Artifact


class Contents(ABC):
    """The contents of a recording's artifacts, each read when it is asked for, and once."""

    @abstractmethod
    def artifact(self, asset: str) -> Artifact:
        """Return the artifact of an asset."""

    @cached_property
    def inventory(self) -> Inventory:
        """Its topics and time span."""
        return Inventory.from_json(self.artifact(INVENTORY.name).read_json("inventory.json"))

    @cached_property
    def pack(self) -> Pack:
        """Its small messages."""
        return Pack(self.artifact(INVENTORY.name).path(PACK_FILE))

    @cached_property
    def calibration(self) -> Calibration:
        """Content of `calibration.json`."""
        return Calibration.from_json(self.artifact(CALIBRATION.name).read_json("calibration.json"))

    @cached_property
    def trajectory(self) -> Trajectory:
        """`global_SE3_ego`."""
        return load_trajectory(self.artifact(EGO_POSES.name))
