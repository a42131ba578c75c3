"""A first recipe from a glance at the recordings, every guess marked as one."""

import re
from collections.abc import Mapping, Sequence
from pathlib import Path

from bagassets.escaping import yaml_scalar
from bagassets.propose.commented_yaml import Sheet
from bagassets.propose.glance import Glance, TopicGlance
from bagassets.propose.grouping import Group, group_recordings, match_globs
from bagassets.propose.propose_rig import RigProposal, propose_rig, write_rig
from bagassets.propose.sensors import find_sensors, modality_of

__all__ = ["propose"]

_LARGE_OFFSET_S = 1.0
_LISTED = 20


def propose(
    glances: Mapping[str, Glance],
    *,
    name: str,
    root: Path | str,
    unreadable: Mapping[str, str] | None = None,
    found: int | None = None,
) -> str:
    """Return the text of a recipe for the recordings, with a comment at each guess.

    It loads as it stands if everything could be guessed. A rig whose recordings say nothing about
    its pose gets an `ego_pose` without value, so that loading names that line until the user decides.

    Args:
        glances: path below the bag root -> what is known of the recording.
        name: name of the project.
        root: bag root as it should be written.
        unreadable: path below the bag root -> why that recording could not be read.
        found: number of recordings there are, if not all were looked at.
    """
    groups, bare = group_recordings(glances)
    sheet = Sheet()
    looked_at = len(glances) + len(unreadable or {})
    count = f"{looked_at} recording{'' if looked_at == 1 else 's'}"
    if found is not None and found > looked_at:
        count += f" out of {found}"
    _head(sheet, count, groups, bare, glances, unreadable or {})
    sheet.field(0, f"name: {yaml_scalar(_slug(name))}")
    sheet.field(0, "bags:")
    sheet.field(1, f"root: {yaml_scalar(str(root))}")
    undefined = sorted(
        {t.msgtype for g in glances.values() for t in g.topics.values() if _lacks_definition(t)}
    )
    if undefined:
        sheet.note(
            1,
            f"not guessed: where the .msg files of {', '.join(undefined)} are; without them, these topics are left "
            "out. Name their folders and add the channels:",
        )
        sheet.off(1, "message_definitions: [msg]")
    _clock(sheet, groups)
    sheet.blank()
    sheet.field(0, "rigs:")
    taken: set[str] = set()
    rigs: list[RigProposal] = []
    for group in groups:
        others = [path for other in groups if other is not group for path in other.recordings]
        rig = propose_rig(group, match_globs(group.recordings, others), taken)
        taken.add(rig.name)
        rigs.append(rig)
        write_rig(sheet, rig)
    if not rigs:
        _no_rig(sheet)
    _scenes(sheet, rigs)
    sheet.field(
        0, "splits:", "of whole recordings; nuscenes-devkit knows these as custom_train and custom_val"
    )
    sheet.field(1, "shares: {train: 0.8, val: 0.2}")
    sheet.field(0, "nuscenes:")
    sheet.field(1, f"version: {yaml_scalar(f'v1.0-{_slug(name)}')}")
    return sheet.text()


def _head(
    sheet: Sheet,
    count: str,
    groups: Sequence[Group],
    bare: Sequence[str],
    glances: Mapping[str, Glance],
    unreadable: Mapping[str, str],
) -> None:
    sheet.note(0, f"Proposed by `bagassets init` from the first seconds of {count}.")
    sheet.note(0, '"guess:" marks what was inferred, "not guessed:" what only you know; look at both.')
    sheet.note(0, "All fields: `bagassets docs recipe`.")
    if len(groups) > 1:
        sheet.note(0, f"guess: {len(groups)} rigs, told apart by their sensor topics.")
    for path, reason in list(unreadable.items())[:_LISTED]:
        sheet.note(0, f"not guessed: {path} could not be read: {reason}")
    for path in bare[:_LISTED]:
        reasons = "; ".join(f"{topic}: {reason}" for topic, reason in find_sensors(glances[path])[1])
        sheet.note(
            0, f"not guessed: {path} has no camera, lidar or radar{f' ({reasons})' if reasons else ''}."
        )
    more = max(0, len(unreadable) - _LISTED) + max(0, len(bare) - _LISTED)
    if more:
        sheet.note(0, f"not guessed: {more} more recordings without usable sensor, or unreadable.")
    sheet.blank()


def _clock(sheet: Sheet, groups: Sequence[Group]) -> None:
    topics = [sensor.topic for group in groups for sensor in find_sensors(group.glance)[0]]
    unset = sorted({topic.name for topic in topics if topic.unstamped})
    spreads = [max(own) - min(own) for own in map(_offsets, groups) if own]
    largest = max(topics, key=lambda topic: abs(topic.offset_s or 0.0), default=None)
    offset_s = 0.0 if largest is None or largest.offset_s is None else largest.offset_s
    if unset:
        sheet.field(0, "clock: log", f"guess: header stamps of {', '.join(unset[:3])} are zero")
    elif max(spreads, default=0.0) > _LARGE_OFFSET_S:
        sheet.field(
            0, "clock: log", f"guess: header stamps of one rig's sensors are up to {max(spreads):.1f} s apart"
        )
    elif largest is not None and abs(offset_s) > _LARGE_OFFSET_S:
        sheet.field(
            0,
            "clock: header",
            f"guess: header stamps of a rig agree, though {largest.name} was logged {abs(offset_s):.1f} s "
            f"{'after' if offset_s > 0 else 'before'} its stamp; `log` is the other choice",
        )
    else:
        sheet.field(0, "clock: header")


def _lacks_definition(topic: TopicGlance) -> bool:
    return topic.problem is not None and "definition" in topic.problem and modality_of(topic) is not None


def _offsets(group: Group) -> list[float]:
    return [s.topic.offset_s for s in find_sensors(group.glance)[0] if s.topic.offset_s is not None]


def _no_rig(sheet: Sheet) -> None:
    sheet.note(1, "not guessed: no recording has a topic of a camera, lidar or radar. A rig looks like this:")
    for line in (
        "- name: rig",
        "  ego_frame: base_link",
        "  ego_pose: {source: odometry, topic: /odom}",
        "  channels:",
        "    CAM_FRONT: {modality: camera, topic: /camera/image_raw}",
    ):
        sheet.off(1, line)
    sheet.blank()


def _scenes(sheet: Sheet, rigs: Sequence[RigProposal]) -> None:
    channels = {name: sensor.modality for rig in rigs for name, sensor in rig.channels.items()}
    if not channels or "LIDAR_TOP" in channels or "camera" in channels.values():
        return
    sheet.field(0, "scenes:")
    sheet.field(1, f"reference: {min(channels)}", "guess: there is neither LIDAR_TOP nor a camera")


def _slug(name: str) -> str:
    return re.sub(r"[^A-Za-z0-9_.-]+", "-", name).strip("-.") or "project"
