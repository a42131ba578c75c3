"""The code location that `workspace.yaml` and `dagster … -m bagassets.definitions` load.

The recipe is the file named by BAGASSETS_RECIPE (a project's `.env` sets it), else
`recipe.yaml` in the current folder, else that of the demo in a source checkout. As long as there
is none of these, the location holds a note that says what to do.
"""

import os
from pathlib import Path

from bagassets.defs.graph.location import build_definitions, note_without_recipe

_FALLBACKS = (Path("recipe.yaml"), Path("build/demo/recipe.yaml"))
_recipe = os.environ.get("BAGASSETS_RECIPE") or next(filter(Path.is_file, _FALLBACKS), None)

# A recipe that is named has to be there: whatever shows its project would else forget it.
defs = note_without_recipe(_FALLBACKS) if _recipe is None else build_definitions(Path(_recipe))
