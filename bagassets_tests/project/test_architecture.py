"""The picture of the architecture is what its script draws of the assets there are."""

from xml.etree import ElementTree as ET

import pytest

from bagassets.formats.catalogue import formats, known_assets
from scripts.architecture import ABOUT, PICTURES, THEMES, draw, edges, ranks

pytestmark = pytest.mark.once

SVG = "{http://www.w3.org/2000/svg}"


@pytest.mark.parametrize("theme", THEMES, ids=lambda theme: theme.suffix or "light")
def test_the_committed_picture_is_what_the_script_draws(theme):
    file = PICTURES / f"architecture{theme.suffix}.svg"
    assert file.read_text(encoding="utf-8") == draw(theme), f"{file.name} is out of date: make docs"


def test_the_readme_shows_both():
    readme = (PICTURES.parents[1] / "README.md").read_text(encoding="utf-8")
    for theme in THEMES:
        assert f'"docs/pictures/architecture{theme.suffix}.svg"' in readme


def test_it_shows_every_asset_and_dataset_once():
    words = [text.text for text in ET.fromstring(draw(THEMES[0])).iter(f"{SVG}text")]
    for name in [*(asset.name for asset in known_assets()), *(f"{kind.name}_dataset" for kind in formats())]:
        assert words.count(name) == 1, name
    assert ABOUT.keys() <= {asset.name for asset in known_assets()}


def test_arrows_lead_right_and_to_all_that_is_read():
    rank, arrows = ranks(), edges()
    assert all(rank[source] < rank[target] for source, target in arrows)

    def upstream(name):
        direct = {source for source, target in arrows if target == name}
        return direct.union(*map(upstream, direct))

    for asset in known_assets():
        assert {one.name for one in asset.reads} <= upstream(asset.name)
