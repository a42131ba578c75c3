"""The checks that our own assets of a vehicle's recordings have."""

from bagassets.formats.catalogue import OUR_ASSETS
from bagassets_tests.recording_build import RECORDING_ASSETS

RECORDING_CHECKS = [check for asset in OUR_ASSETS if asset.name in RECORDING_ASSETS for check in asset.checks]
