"""Projects whose recordings hold messages of plug-ins, and building them."""

from bagassets.engine.execute import BuildFailure
from bagassets.recipe import load_recipe
from bagassets.recordings.digest import recording_digest, recording_stat
from bagassets.recordings.discover import discover
from bagassets.store.store import Store
from bagassets_tests.plugin_drive import RECIPE
from bagassets_tests.recording_build import RecordingBuild


def project(folder, recording, text=RECIPE):
    bags = folder / "bags"
    bags.mkdir(parents=True)
    (bags / "drive").symlink_to(recording)
    (folder / "recipe.yaml").write_text(text)
    return load_recipe(folder / "recipe.yaml")


def build(recipe, *, dry=False):
    """Return asset -> result, and asset -> error."""
    (recording,) = discover(recipe.bags).recordings.values()
    digest, stat = recording_digest(recording).digest, recording_stat(recording)
    results = RecordingBuild(recipe, Store(recipe.store_path), recording, digest, stat, dry=dry).build()
    made = {}
    try:
        for result in results:
            made[result.asset] = result
    except BuildFailure as failure:
        return made, {asset: str(err) for asset, err in failure.errors.items()}
    return made, {}


def channel(recipe, made, asset, name):
    entry = made[asset].artifact.read_json("channels.json")[name]
    return entry, Store(recipe.store_path).artifact(entry["artifact"])
