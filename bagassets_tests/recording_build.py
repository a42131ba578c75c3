"""Making the assets of one recording without Dagster, as tests like it."""

import yaml

from bagassets.base.errors import BagAssetsError
from bagassets.engine.execute import AssetResult, BuildFailure, Skipped, execute
from bagassets.engine.graph import SELECTION, Graph
from bagassets.formats.catalogue import known_assets, recording_assets
from bagassets.recipe.model import Recipe
from bagassets.sample.recipe import sample_recipe

UPSTREAM = {asset.name: tuple(one.name for one in asset.reads) for asset in known_assets()}
ASSETS = recording_assets(Recipe.model_validate(yaml.safe_load(sample_recipe())))
RECORDING_ASSETS = ("bag", *(name for name in ASSETS.names if name not in ASSETS.optional))


class RecordingBuild:
    """The assets of one recording under a recipe; with `dry`, those that are known, and nothing runs."""

    def __init__(self, recipe, store, recording, digest, stat, given=None, *, workers=None, dry=False):
        self.assets = recording_assets(recipe)
        self.assets.store = store
        self.facts = (recording, digest, stat)
        self.given = given or {}
        self.workers = workers
        self.dry = dry

    def graph(self, wanted=None):
        return Graph(self.assets, *self.facts, wanted=wanted, given=self.given)

    def build(self, wanted=None):
        self.last = graph = self.graph(wanted)
        return self._known(graph) if self.dry else execute(graph, threads=self.workers)

    @staticmethod
    def _known(graph):
        for name in graph.assets.names:
            if graph.makes(name) and (outcome := graph.node(name).outcome) is not None:
                yield AssetResult(name, outcome.artifact, outcome.action_digest, cached=True, seconds=0.0)
        if graph.node(SELECTION).skipped is not None:
            reason = graph.node(SELECTION).skipped
            yield from (Skipped(name, reason) for name in graph.assets.names if graph.node(name).skipped)
            return
        states = graph.states()
        errors = {
            name: BagAssetsError(states[name].reason)
            for name in graph.assets.names
            if graph.makes(name) and states[name].state in {"failed", "missing"}
        }
        if errors:
            raise BuildFailure(errors, graph.recording.path)
