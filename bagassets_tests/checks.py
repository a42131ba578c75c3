"""The checks that our own assets of recordings have."""

from bagassets.formats.catalogue import OUR_ASSETS

RECORDING_CHECKS = [check for asset in OUR_ASSETS for check in asset.checks]
