"""A first recipe from what recordings hold: every guess marked as one, every open question where it is to be answered."""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

from bagassets.base.escaping import yaml_scalar
from bagassets.base.quantities import count_text
from bagassets.propose.calibration_files import FoundCalibration
from bagassets.propose.commented_yaml import Question, Sheet
from bagassets.propose.grouping import group_recordings, match_globs
from bagassets.propose.poses import PoseProposal, pose_candidates
from bagassets.propose.rig_text import urdf_name, write_rig
from bagassets.propose.rigs import RigProposal, propose_rig, uses_of
from bagassets.propose.sensors import find_sensors, lacks_definition, shown_type
from bagassets.propose.signals import write_lerobot
from bagassets.propose.summary import RecordingSummary, TopicUse
from bagassets.recipe.model import Scenes

_LISTED = 20


@dataclass(frozen=True)
class Bare:
    """A recording without a usable sensor.

    Attributes:
        path: where it is, below the bag root.
        reason: why it has none.
        topic_uses: what its topics are.
    """

    path: str
    reason: str
    topic_uses: list[TopicUse]


@dataclass(frozen=True)
class Proposal:
    """A proposed recipe.

    Attributes:
        text: content of `recipe.yaml`.
        rigs: the rigs in it.
        bare: recordings that belong to none, as they have no usable sensor.
        guesses: number of comments in it that mark a guess.
        questions: what must be decided before a build can succeed.
        files: name -> content of files that the recipe expects beside it.
    """

    text: str
    rigs: list[RigProposal]
    bare: list[Bare]
    guesses: int
    questions: list[Question]
    files: Mapping[str, str] = field(default_factory=dict)


def propose_recipe(
    summaries: Mapping[str, RecordingSummary],
    *,
    name: str,
    root: Path | str,
    include: Sequence[str] = (),
    series: Mapping[str, bool | Sequence[str]] | None = None,
    asked: Mapping[str, str] | None = None,
    unreadable: Mapping[str, str] | None = None,
    found: int | None = None,
    digest_attributes: bool = False,
    calibrations: Sequence[FoundCalibration] = (),
    urdfs: bool = False,
) -> Proposal:
    """Return a recipe for the recordings.

    It loads as it stands if everything could be guessed. A rig whose recordings say nothing about
    its pose gets an `ego_pose` without value, so that loading names that line until the user decides.

    Args:
        summaries: path below the bag root -> what the recording holds.
        name: name of the project.
        root: bag root as it should be written.
        include: globs of the recordings that the project takes; none = all below the root.
        series: the recipe's `bags.series`.
        asked: path of a whole drive -> the question whether some recordings are its parts.
        unreadable: path below the bag root -> why that recording could not be read.
        found: number of recordings there are, if not all were looked into.
        digest_attributes: builds may store digests beside the recordings.
        calibrations: calibration files that lie near the recordings.
        urdfs: robot descriptions that were recorded may become files beside the recipe.
    """
    unreadable = unreadable or {}
    groups, without_sensor = group_recordings(summaries)
    bare = [_bare(path, summaries[path]) for path in without_sensor]
    rigs: list[RigProposal] = []
    for group in groups:
        others = [path for other in groups if other is not group for path in other.recordings]
        match, taken = match_globs(group.recordings, others), {rig.name for rig in rigs}
        rigs.append(propose_rig(group, match, taken, urdfs=urdfs))
    if not all(rig.is_arm for rig in rigs):
        rigs = [replace(rig, needs_poses=True) for rig in rigs]
    sheet = Sheet()
    looked_into = len(summaries) + len(unreadable)
    count = count_text(len(summaries), "recording")
    if found is not None and found > looked_into:
        count += f" out of {found}"
    _head(sheet, count, rigs, bare, unreadable)
    sheet.field(0, f"name: {yaml_scalar(_slug(name))}")
    sheet.field(0, "bags:")
    sheet.field(1, f"root: {yaml_scalar(str(root))}")
    if include:
        sheet.field(1, f"include: [{', '.join(map(yaml_scalar, include))}]")
    _series(sheet, series or {}, asked or {})
    if digest_attributes:
        sheet.field(1, "digest_attributes: true", "digests are stored beside the recordings")
    else:
        sheet.note(
            1, "uncomment to store digests beside the recordings, so that nobody else has to hash them:"
        )
        sheet.off(1, "digest_attributes: true")
    _definitions(sheet, summaries, rigs)
    clocks = {rig.clock.clock for rig in rigs}
    usual = "log" if clocks == {"log"} else "header"
    reason = next((rig.clock.reason for rig in rigs if rig.clock.clock == usual and rig.clock.reason), "")
    sheet.guess(0, f"clock: {usual}", reason)
    sheet.blank()
    sheet.field(0, "rigs:")
    for rig in rigs:
        write_rig(sheet, rig, calibrations, clock=rig.clock.clock != usual)
    if not rigs:
        _no_rig(sheet, bare, unreadable)
    if any(rig.signals for rig in rigs):
        write_lerobot(sheet, rigs)
    if not rigs or not all(rig.is_arm for rig in rigs):
        _scenes(sheet, [rig for rig in rigs if rig.channels])
        sheet.field(
            0, "splits:", "of whole recordings; nuscenes-devkit knows these as custom_train and custom_val"
        )
        sheet.field(1, "shares: {train: 0.8, val: 0.2}")
        sheet.field(0, "nuscenes:")
        sheet.field(1, f"version: {yaml_scalar(f'v1.0-{_slug(name)}')}")
    files = {urdf_name(rig): rig.urdf.topic.urdf for rig in rigs if rig.urdf is not None and not rig.is_arm}
    return Proposal(sheet.text(), rigs, bare, sheet.guesses, sheet.questions, files)


def _series(sheet: Sheet, series: Mapping[str, bool | Sequence[str]], asked: Mapping[str, str]) -> None:
    if series:
        sheet.field(1, "series:")
    for whole, parts in series.items():
        if not isinstance(parts, bool):
            sheet.field(2, f"{yaml_scalar(whole)}: [{', '.join(map(yaml_scalar, parts))}]")
    for question in asked.values():
        sheet.ask(1, "bags.series", question)
    if asked:
        sheet.off(1, f"series: {{{', '.join(f'{yaml_scalar(whole)}: true' for whole in asked)}}}")


def _bare(path: str, summary: RecordingSummary) -> Bare:
    """Say what a recording without a usable sensor holds instead."""
    left_out = find_sensors(summary)[1]
    poses = next(iter(pose_candidates(summary, "base_link")), PoseProposal())
    if left_out:
        reason = "no camera, lidar or radar that can be used"
    elif poses.fields or summary.transforms:
        reason = "nothing to convert: it has poses or transforms, but no camera, lidar or radar"
    else:
        reason = "nothing to convert: it has no camera, lidar or radar"
    return Bare(path, reason, uses_of(summary, {}, poses, [], left_out))


def _head(
    sheet: Sheet,
    count: str,
    rigs: Sequence[RigProposal],
    bare: Sequence[Bare],
    unreadable: Mapping[str, str],
) -> None:
    sheet.note(0, f"Proposed by `bagassets init` from the first seconds of {count}.")
    sheet.note(0, '"guess:" marks what was inferred, "to be decided:" what only you know, and a build needs.')
    sheet.note(0, "All fields: `bagassets docs recipe`.")
    if len(rigs) > 1:
        sheet.guess_note(0, f"{len(rigs)} rigs, told apart by their sensors, frames and poses.")
    for path, reason in list(unreadable.items())[:_LISTED]:
        sheet.note(0, f"left out: {path}: {reason}")
    for one in bare[:_LISTED]:
        reasons = "; ".join(f"{use.topic.name}: {use.text}" for use in one.topic_uses if use.text)
        sheet.note(0, f"left out: {one.path}: {one.reason}{f' ({reasons})' if reasons else ''}")
    if more := max(0, len(unreadable) - _LISTED) + max(0, len(bare) - _LISTED):
        sheet.note(
            0, f"left out: {count_text(more, 'more recording')}, unreadable or without a usable sensor"
        )
    sheet.blank()


def _definitions(
    sheet: Sheet, summaries: Mapping[str, RecordingSummary], rigs: Sequence[RigProposal]
) -> None:
    """Ask for the definitions of sensors' types; without them a build can do the rest, if there is any."""
    types = sorted({t.msgtype for s in summaries.values() for t in s.topics.values() if lacks_definition(t)})
    if not types:
        return
    names = ", ".join(map(shown_type, types))
    text = f"the folders of .msg files that define {names}; name them, and add the channels"
    if rigs:
        sheet.guess_note(1, f"left out for want of {text}:")
    else:
        sheet.ask(1, "bags.message_definitions", text, ":")
    sheet.off(1, "message_definitions: [msg]")


def _no_rig(sheet: Sheet, bare: Sequence[Bare], unreadable: Mapping[str, str]) -> None:
    uses = [use for one in bare for use in one.topic_uses]
    undecodable = {use.topic.name: use.text for use in uses if use.status == "not decodable"}
    left_out = {use.topic.name: use.text for use in uses if use.status == "left out"}
    elsewhere = "name another folder with --bags, and --force to replace this recipe"
    if undecodable:
        text = f"no sensor can be decoded. {_first(undecodable)}"
    elif unreadable and not bare:
        text = f"no recording could be read; fix them and repeat the command with --force, or {elsewhere}"
    elif left_out:
        text = f"no topic is proposed for a sensor. {_first(left_out)}; add what is one as a channel, or {elsewhere}"
    else:
        text = f"no recording has a camera, lidar or radar, so there is nothing to convert; {elsewhere}"
    sheet.ask(1, "rigs", text, below=True)
    sheet.note(1, "A rig looks like this:")
    for line in (
        "- name: rig",
        "  ego_frame: base_link",
        "  ego_pose: {source: odometry, topic: /odom}",
        "  channels:",
        "    CAM_FRONT: {modality: camera, topic: /camera/image_raw}",
    ):
        sheet.off(1, line)
    sheet.blank()


def _first(reasons: Mapping[str, str]) -> str:
    """Return the first topic of several and its reason."""
    topic, why = min(reasons.items())
    return f"{topic}: {why}" + (
        f" (and {count_text(len(reasons) - 1, 'more topic')})" if len(reasons) > 1 else ""
    )


def _scenes(sheet: Sheet, rigs: Sequence[RigProposal]) -> None:
    channels = {name: sensor.modality for rig in rigs for name, sensor in rig.channels.items()}
    if not channels:
        return
    needs_reference = "LIDAR_TOP" not in channels and "camera" not in channels.values()
    topics = [rig.channels[_reference(rig)].topic.name for rig in rigs]
    short_s = [rig.summary.short_s.get(topic) for rig, topic in zip(rigs, topics, strict=True)]
    known_s = [length_s for length_s in short_s if length_s is not None]
    is_short = len(known_s) == len(short_s)
    if not needs_reference and not is_short:
        return
    sheet.field(0, "scenes:")
    if needs_reference:
        sheet.guess(1, f"reference: {min(channels)}", "there is neither LIDAR_TOP nor a camera")
    if is_short:
        sheet.guess(
            1,
            "min_length_s: 0",
            f"the longest recording has {max(known_s):.2g} s of {topics[0]}; the default, {Scenes().min_length_s:g} s, would leave no "
            "scene",
        )


def _reference(rig: RigProposal) -> str:
    """Return the channel that decides about scenes by default."""
    cameras = (name for name, sensor in rig.channels.items() if sensor.modality == "camera")
    return "LIDAR_TOP" if "LIDAR_TOP" in rig.channels else next(cameras, min(rig.channels))


def _slug(name: str) -> str:
    return re.sub(r"[^A-Za-z0-9_.-]+", "-", name).strip("-.") or "project"
