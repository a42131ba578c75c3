"""The reference of the assets of recordings is what stands in docs/, and says something of each."""

from pathlib import Path

from bagassets.cli.docs import asset_reference
from bagassets.formats.catalogue import known_assets

PAGE = Path(__file__).parent.parent / "docs" / "assets.md"


def test_docs_are_up_to_date():
    assert PAGE.read_text(encoding="utf-8") == asset_reference(), (
        "docs/assets.md is out of date: bagassets docs assets > docs/assets.md"
    )


def test_every_asset_says_what_it_is():
    for asset in known_assets():
        assert asset.title.endswith("."), asset.name
        assert "\n" not in asset.title, asset.name
        assert asset.kinds, asset.name
