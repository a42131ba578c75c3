"""Running actions again in a process that differs from the first one as much as this machine allows.

Results must not depend on the number of workers, the kind of processor (BLAS, numpy and OpenCV choose their code by
it), hash seeds or the time zone.
"""

import json
import os
import platform
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from bagassets.base.errors import BagAssetsError
from bagassets.base.json_types import JsonObject

# Builds encode with as many threads as Dagster leaves them, usually one.
WORKERS = 3
# The oldest kernels, which every processor of that architecture can run.
_CORETYPES = {"x86_64": "Nehalem", "AMD64": "Nehalem", "aarch64": "ARMV8", "arm64": "ARMV8"}


def other_environment() -> dict[str, str]:
    """Return environment variables that make libraries choose different code than they do here by default."""
    import cv2
    import numpy as np

    variables = {
        "OPENBLAS_NUM_THREADS": "3",
        "PYTHONHASHSEED": "4711",
        "TZ": "Pacific/Kiritimati",
    }
    coretype = _CORETYPES.get(platform.machine())
    if coretype is not None and os.environ.get("OPENBLAS_CORETYPE") != coretype:
        variables["OPENBLAS_CORETYPE"] = coretype
    extensions: Any = np.show_config(mode="dicts")
    found = extensions["SIMD Extensions"].get("found", ())
    if found:
        variables["NPY_DISABLE_CPU_FEATURES"] = " ".join(found)
    chosen_at_runtime = [name[1:] for name in cv2.getCPUFeaturesLine().split() if name.startswith("*")]
    if chosen_at_runtime:
        variables["OPENCV_CPU_DISABLE"] = ",".join(chosen_at_runtime)
    return variables


def rebuild_elsewhere(
    recipe_file: Path, key: str, actions: Sequence[str], environment: dict[str, str]
) -> list[JsonObject]:
    """Run actions of a recording in a separate process; return the fields of each `Rebuilt`.

    Raises:
        BagAssetsError: the process failed as a whole.
    """
    request = json.dumps({"recipe": str(recipe_file), "key": key, "actions": list(actions)})
    done = subprocess.run(
        [sys.executable, "-m", "bagassets.cli.rebuild_process"],
        input=request,
        capture_output=True,
        text=True,
        check=False,
        env={**os.environ, **environment},
    )
    if done.returncode != 0:
        lines = done.stderr.strip().splitlines()
        reason = lines[-1] if lines else f"it ended with {done.returncode}"
        raise BagAssetsError(f"{key}: the process that ran its actions again failed ({reason}).")
    results: list[JsonObject] = json.loads(done.stdout)
    return results


def _main() -> None:
    from bagassets.engine.rebuild import rebuild
    from bagassets.formats.catalogue import recording_assets
    from bagassets.recipe import load_recipe

    # Libraries print to standard output, too (OpenCV its log): keep that apart from the answer.
    answer = os.fdopen(os.dup(sys.stdout.fileno()), "w")
    os.dup2(sys.stderr.fileno(), sys.stdout.fileno())
    request = json.load(sys.stdin)
    recipe = load_recipe(Path(request["recipe"]))
    recipe.state.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(prefix="verify-", dir=recipe.state) as scratch:
        made = rebuild(
            recording_assets(recipe), request["key"], request["actions"], Path(scratch), threads=WORKERS
        )
    with answer:
        json.dump([asdict(result) for result in made], answer)


if __name__ == "__main__":
    _main()
