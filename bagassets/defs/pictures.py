"""Pictures on a materialization, as the web UI shows them."""

from base64 import b64encode

import dagster as dg

from bagassets.assets.preview import FACTS
from bagassets.build.execute import AssetResult
from bagassets.preview.pictures import TITLES

__all__ = ["picture_metadata"]


def picture_metadata(result: AssetResult) -> dict[str, dg.MetadataValue[str]]:
    """Return the small pictures of `preview` inside Markdown; nothing for other assets.

    They are data URIs: the web UI cannot read files of the store, which may lie on another machine.
    """
    if result.asset != "preview":
        return {}
    metadata: dict[str, dg.MetadataValue[str]] = {}
    for name in result.artifact.read_json(FACTS)["pictures"]:
        data = b64encode(result.artifact.path(f"inline/{name}.jpg").read_bytes()).decode()
        metadata[f"picture_{name}"] = dg.MetadataValue.md(f"![{TITLES[name]}](data:image/jpeg;base64,{data})")
    return metadata
