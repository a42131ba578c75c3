"""What the docs say about the assets of recordings is generated from the assets, or compared with them."""

import re
from itertools import product
from pathlib import Path

from bagassets.cli.docs import asset_reference
from bagassets.formats.catalogue import known_assets
from scripts.docs import input_table

DOCS = Path(__file__).parents[2] / "docs"
PAGE = DOCS / "assets.md"
HOW_IT_DECIDES = (DOCS / "how-it-decides.md").read_text("utf-8")


def test_docs_are_up_to_date():
    assert PAGE.read_text(encoding="utf-8") == asset_reference(), "docs/assets.md is out of date: make docs"
    signals = asset_reference().split("## signals\n")[1].split("\n## ")[0]
    assert "| one artifact per | signal |" in signals


def test_every_asset_says_what_it_is():
    for asset in known_assets():
        assert asset.title.endswith("."), asset.name
        assert "\n" not in asset.title, asset.name
        assert asset.kinds, asset.name


def test_the_table_of_inputs_is_that_of_the_assets():
    assert input_table() in HOW_IT_DECIDES


def test_every_asset_has_parameters():
    for line in input_table().splitlines()[2:]:
        assert re.fullmatch(r"`\w+`(, `\w+`)*", line.split(" | ")[2]), line


def test_the_graph_is_that_of_the_assets():
    """Edges are what assets read, and everything else that they read is upstream of that."""
    edges = set()
    for line in HOW_IT_DECIDES.partition("```mermaid\n")[2].partition("```")[0].splitlines()[1:]:
        sources, targets = re.split(r" --> | -\..*?\.-> ", re.sub(r"\(\[.*?\]\)", "", line.strip()))
        edges |= set(product(sources.split(" & "), targets.split(" & ")))
    reads = {asset.name: {one.name for one in asset.reads} or {"bag"} for asset in known_assets()}

    def upstream(name):
        direct = {source for source, target in edges if target == name}
        return direct.union(*map(upstream, direct))

    assert {source for source, _ in edges} | {target for _, target in edges} >= reads.keys()
    for name, read in reads.items():
        assert {source for source, target in edges if target == name} <= read, name
        assert read <= upstream(name), name
