"""A sample drive with oddities, and its calibration and frames."""

from functools import cached_property

from bagassets.recipe import load_recipe
from bagassets.recordings.digest import recording_digest, recording_stat
from bagassets.recordings.discover import discover
from bagassets.sample.drive import Target, write_recordings
from bagassets.sample.recipe import sample_recipe
from bagassets.store.store import Store
from bagassets_tests.recording_build import RecordingBuild


class OddDrive:
    """A part of a second, as MCAP."""

    def __init__(self, folder, *odd, duration_s=0.15):
        self.folder = folder
        self.path = folder / "recordings" / "drive.mcap"
        self.truth = write_recordings([Target(self.path, "mcap")], 3, "small", duration_s, odd=odd)

    def made(self, *assets, without=None):
        """Build some assets, leaving a channel out of the recipe if that is wanted; return asset -> artifact."""
        lines = sample_recipe().splitlines(keepends=True)
        (self.folder / "recipe.yaml").write_text(
            "".join(line for line in lines if f" {without}: " not in line)
        )
        recipe = load_recipe(self.folder / "recipe.yaml")
        (recording,) = discover(recipe.bags).recordings.values()
        self.store = Store(recipe.store_path)
        digest, stat = recording_digest(recording).digest, recording_stat(recording)
        build = RecordingBuild(recipe, self.store, recording, digest, stat)
        return {result.asset: result.artifact for result in build.build({"inventory", *assets})}

    @cached_property
    def artifacts(self):
        return self.made("calibration", "frames")

    @property
    def calibration(self):
        return self.artifacts["calibration"].read_json("calibration.json")

    def channel(self, name):
        """The artifact of a camera."""
        entry = self.artifacts["frames"].read_json("channels.json")[name]
        return self.store.artifact(entry["artifact"])
