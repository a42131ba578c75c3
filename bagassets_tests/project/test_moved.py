"""Names that modules had before: what users' code imports by them is the one module that there is."""

import subprocess
import sys
from importlib import import_module, util

import pytest

import bagassets
from bagassets_tests.small_drive import RECIPE

pytestmark = pytest.mark.once

# What `dagster.yaml`, `workspace.yaml`, `deploy/`, pages and examples of 0.1.0, and those of the day before the modules
# moved, name. Projects and packages that were written after them say so for ever: nothing leaves this list.
NAMED = {
    "bagassets": "RecordingDatasets build open_dataset",
    "bagassets.assets.asset": "Asset Facts Inputs Summary Use",
    "bagassets.assets.calibration": "CALIBRATION",
    "bagassets.assets.ego_poses": "EGO_POSES",
    "bagassets.assets.frames": "FRAMES",
    "bagassets.assets.lidar_file": "read_lidar_file",
    "bagassets.assets.sweeps": "SWEEPS",
    "bagassets.decode.boxes": "",
    "bagassets.decode.fields": "stamp_and_frame",
    "bagassets.decode.model": "ImageReading",
    "bagassets.definitions": "defs",
    "bagassets.defs": "Workspace all_recordings build_definitions channels errors_explained follow_recordings per_recording"
    " publish recipe_beside skipped",
    "bagassets.defs.launcher": "BagAssetsRunLauncher",
    "bagassets.defs.services": "",
    "bagassets.defs.slurm.launcher": "SlurmRunLauncher",
    "bagassets.defs.sqlite_storage": "ProjectStorage",
    "bagassets.errors": "BagAssetsError DatasetError DecodeError",
    "bagassets.formats.format": "FACTS DatasetCheck Entry Format Joined Link Member Samples",
    "bagassets.formats.json_files": "json_bytes write_hashed",
    "bagassets.geometry.se3": "SE3 Floats",
    "bagassets.quality.finding": "Finding",
    "bagassets.reader": "",
    "bagassets.recipe.model": "CameraChannel LidarChannel Recipe Rig",
    "bagassets.recipe.model_base": "ChannelName DatasetSettings",
    "bagassets.splits": "SplitShare",
    "bagassets.store.artifact": "Artifact ArtifactWriter",
    "bagassets.store.canonical": "digest_json",
}


@pytest.mark.parametrize("module", NAMED)
def test_what_others_import_is_importable(module, tmp_path, monkeypatch):
    if module == "bagassets.definitions":
        recipe = tmp_path / "recipe.yaml"
        recipe.write_text(RECIPE.format(name="named", root=tmp_path))
        monkeypatch.setenv("BAGASSETS_RECIPE", str(recipe))
    found = import_module(module)
    assert [name for name in NAMED[module].split() if not hasattr(found, name)] == []


@pytest.mark.parametrize(("former", "name"), bagassets._MOVED.items())
def test_a_module_is_found_by_its_former_name(former, name):
    assert import_module(former) is import_module(name)
    assert import_module(name).__name__ == name


def test_what_is_in_a_package_moves_with_it_and_is_no_copy():
    code = (
        "from bagassets.quality.finding import Finding as before\n"
        "import bagassets.assets.quality.finding as now\n"
        "import bagassets.errors\n"
        "from bagassets import errors\n"
        "from bagassets.base.errors import BagAssetsError\n"
        "print(before is now.Finding, bagassets.errors.BagAssetsError is BagAssetsError is errors.BagAssetsError)"
    )
    done = subprocess.run([sys.executable, "-c", code], check=True, capture_output=True, text=True)
    assert done.stdout == "True True\n"


def test_other_names_are_not_found():
    assert util.find_spec("bagassets.nothing") is None
    with pytest.raises(
        ModuleNotFoundError, match=r"bagassets\.quality\.nothing|bagassets\.assets\.quality\.nothing"
    ):
        import_module("bagassets.quality.nothing")


def test_threads_that_import_by_a_former_name_at_once_find_it():
    """Also one that comes while another is about to load the package: that takes long here."""
    code = (
        "import sys, threading, time, bagassets; from importlib.util import find_spec; failed = []\n"
        "class Slow:\n"
        "    def find_spec(self, name, *_):\n"
        "        if name == 'bagassets.assets.quality': time.sleep(0.5)\n"
        "sys.meta_path.insert(0, Slow())\n"
        "def load(after_s):\n"
        "    time.sleep(after_s)\n"
        "    try:\n"
        "        find_spec('bagassets.quality.finding')\n"
        "    except ImportError as err:\n"
        "        failed.append(err)\n"
        "threads = [threading.Thread(target=load, args=[after_s]) for after_s in (0.0, 0.2)]\n"
        "[one.start() for one in threads]; [one.join() for one in threads]\n"
        "import bagassets.assets.quality as now\n"
        "print(failed, now.__spec__.name, sys.modules['bagassets.quality'] is now)"
    )
    done = subprocess.run([sys.executable, "-c", code], check=True, capture_output=True, text=True)
    assert done.stdout == "[] bagassets.assets.quality True\n"
