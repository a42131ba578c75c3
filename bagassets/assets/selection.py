"""Which rig made a recording, and whether the recording takes part at all."""

from bagassets.recipe.model import Recipe, Rig
from bagassets.recordings.globs import matches
from bagassets.recordings.inventory import Inventory


def choose_rig(recipe: Recipe, *names: str) -> Rig | None:
    """Return the first rig whose globs match the path of a recording below the bag root, or that of one of its parts."""
    for rig in recipe.rigs:
        if any(matches(pattern, name) for pattern in rig.match for name in names):
            return rig
    return None


def present_channels(rig: Rig, inventory: Inventory) -> dict[str, str]:
    """Return channel -> topic of the channels that have readable messages in the recording."""
    return {
        name: channel.topic
        for name, channel in sorted(rig.channels.items())
        if inventory.has_readable(channel.topic)
    }


def skip_reason(recipe: Recipe, rig: Rig | None, inventory: Inventory) -> str | None:
    """Return why a recording takes no part in the dataset, or None if it does."""
    if rig is None:
        return "no rig of the recipe matches its path"
    duration_s = inventory.duration_s
    if duration_s < recipe.bags.min_duration_s:
        return f"{duration_s:.1f} s long, bags.min_duration_s asks for {recipe.bags.min_duration_s:g} s"
    present = present_channels(rig, inventory)
    missing = [name for name in rig.required if name not in present]
    if missing:
        topics = ", ".join(f"{name} ({rig.channels[name].topic})" for name in missing)
        return f"required channel without readable messages: {topics}"
    if not present and not any(inventory.has_readable(one.topic) for one in rig.signals.values()):
        either = " or signals" if rig.signals else ""
        return f"none of the channels{either} of rig {rig.name} has readable messages"
    return None
