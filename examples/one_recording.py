"""Build one recording, where Dagster need not even be installed: `python one_recording.py recipe.yaml drive_1.bag`.

A second time every result is found in the store, and nothing runs.
"""

import sys

from bagassets.engine.execute import Skipped, execute
from bagassets.engine.graph import Graph
from bagassets.formats.catalogue import recording_assets
from bagassets.recipe.load import load_recipe
from bagassets.recordings.discover import discover

path, key = sys.argv[1:]
recipe = load_recipe(path)
recording = discover(recipe.bags).recordings[key]
graph = Graph.of(recording_assets(recipe), recording)
for result in execute(graph):
    if isinstance(result, Skipped):
        print(f"{result.asset}: skipped, {result.reason}")
    else:
        print(f"{result.asset}: {'found' if result.cached else 'made'}, {result.artifact.files}")
