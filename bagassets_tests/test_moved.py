"""Names that modules had before: what users' code imports by them is the one module that there is."""

import subprocess
import sys
from importlib import import_module, util

import pytest

import bagassets


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
