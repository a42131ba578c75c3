"""Rules about scenes: a recording that takes part gives at least one."""

from collections.abc import Mapping
from typing import Any

from bagassets.quality.finding import Finding

__all__ = ["scenes_made"]


def scenes_made(facts: Mapping[str, Any]) -> Finding:
    """Check that a recording gave a scene, and say why it gave none.

    Args:
        facts: content of `facts.json` of the step `nuscenes_tables`.
    """
    counts = facts["counts"]
    told = {name: counts[name] for name in ("scenes", "samples", "remainder_s", "refused_keyframes")}
    return Finding([] if counts["scenes"] else [f"it gives no scene: {_reason(facts)}"], told)


def _reason(facts: Mapping[str, Any]) -> str:
    counts, reference = facts["counts"], facts["reference"]
    if counts["refused_keyframes"]:
        return (
            f"{counts['refused_keyframes']} keyframes lack a channel within scenes.tolerance_s, and "
            "scenes.missing says refuse"
        )
    if counts["remainder_s"]:
        return f"its {counts['remainder_s']:g} s are shorter than scenes.min_length_s"
    if counts["channels"][reference].get("without_pose"):
        return f"the readings of {reference} have no ego pose"
    return f"{reference} has too few readings to make one of scenes.min_length_s"
