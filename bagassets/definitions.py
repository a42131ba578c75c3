"""The code location that `workspace.yaml` and `dagster … -m bagassets.definitions` load.

The recipe is the file named by BAGASSETS_RECIPE (a project's `.env` sets it), else
`recipe.yaml` in the current folder, else that of the demo in a source checkout.
"""

import os
from pathlib import Path

from bagassets.defs.location import build_definitions

_FALLBACKS = (Path("recipe.yaml"), Path("build/demo/recipe.yaml"))
_recipe = os.environ.get("BAGASSETS_RECIPE") or next(filter(Path.is_file, _FALLBACKS), _FALLBACKS[0])

defs = build_definitions(Path(_recipe))
