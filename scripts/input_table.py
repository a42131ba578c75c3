"""Write what pages of docs/ show of the assets and decoders: the graph, what each asset reads, and the types that are decoded.

    python scripts/input_table.py

`bagassets_tests/test_asset_reference.py` compares the pages with it.
"""

from itertools import groupby
from pathlib import Path

from bagassets.assets.asset import AnyAsset
from bagassets.base.plugins import FAMILIES
from bagassets.cli.docs import parameters_of, reads_of
from bagassets.decode.registry import expected_types
from bagassets.formats.catalogue import formats, known_assets
from bagassets.recipe.model import Recipe

DOCS = Path(__file__).parents[1] / "docs"


def input_table() -> str:
    """Return the table."""
    rows = [
        (f"`{asset.name}`", reads_of(asset), parameters_of(asset), ", ".join(asset.libraries))
        for asset in known_assets()
    ]
    lines = ["| asset | reads | parameters | libraries |", "|---|---|---|---|"]
    return "\n".join([*lines, *(f"| {' | '.join(row)} |" for row in rows)])


def graph() -> str:
    """Return the graph of the assets, without edges that others imply; those that not every recipe has are dashed."""
    camera = {"modality": "camera", "topic": "/image"}
    rig = {"name": "small", "ego_pose": {"source": "fixed"}, "channels": {"CAM_FRONT": camera}}
    recipe = Recipe.model_validate({"name": "small", "bags": {"root": "."}, "rigs": [rig]})
    edges = []
    for asset in known_assets():
        always = asset.reads
        if asset.waits_for is not None:
            needed = asset.needs(asset.params(recipe, recipe.rigs[0]), None)
            always = tuple(one for one in asset.reads if one.name in needed)
            edges += [
                (one.name, "-. if the recipe asks for it .->", asset.name)
                for one in asset.reads
                if one not in always
            ]
        sources = " & ".join(_direct(always)) or "bag([bag])"
        edges.append((sources, "-->", asset.name))
    lines = [
        f"  {sources} {arrow} {' & '.join(target for _, _, target in same)}"
        for (sources, arrow), same in groupby(sorted(edges, key=edges.index), key=lambda edge: edge[:2])
    ]
    parts = " & ".join(kind.part for kind in formats())
    datasets = " & ".join(kind.asset for kind in formats())
    lines += [f"  {parts} --> dataset_inputs([dataset_inputs])", f"  dataset_inputs --> {datasets}"]
    return "\n".join(["```mermaid", "flowchart LR", *lines, "  ego_poses --> trajectory_map", "```"])


def _direct(reads: tuple[AnyAsset, ...]) -> list[str]:
    """Return those of the assets that none of the others reads."""
    implied = {name for one in reads for name in _upstream(one)}
    return [one.name for one in reads if one.name not in implied]


def _upstream(asset: AnyAsset) -> set[str]:
    """Return what an asset always reads, directly or not."""
    if asset.waits_for is not None:
        return set()
    return {name for one in asset.reads for name in (one.name, *_upstream(one))}


def decoder_table() -> str:
    """Return the types of messages that each family has built-in decoders for."""
    rows = [f"| `{family}` | {expected_types(family)} |" for family in FAMILIES]
    return "\n".join(["| family | types |", "|---|---|", *rows])


def pages() -> dict[Path, str]:
    """Return page -> its text, with all of these in their places."""
    found = {}
    for name, parts in (
        ("how-it-decides.md", {"graph": graph(), "inputs": input_table()}),
        ("decoders.md", {"decoders": decoder_table()}),
    ):
        text = (DOCS / name).read_text("utf-8")
        for part, content in parts.items():
            begin, end = f"<!-- {part} -->\n", f"\n<!-- end of {part} -->"
            before, _, rest = text.partition(begin)
            text = before + begin + content + end + rest.partition(end)[2]
        found[DOCS / name] = text
    return found


if __name__ == "__main__":
    for path, text in pages().items():
        path.write_text(text, "utf-8")
