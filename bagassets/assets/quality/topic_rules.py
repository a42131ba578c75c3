"""Rules about the inventory: channels, rates, pauses and header stamps."""

from collections.abc import Callable

from bagassets.assets.quality.finding import Finding, clock
from bagassets.decode.robots import robot_of, robots_of
from bagassets.recipe.model import Rig
from bagassets.recipe.model_base import Clock
from bagassets.recipe.model_checks import ChannelsCheck, StampsCheck, TopicLimits, TopicsCheck
from bagassets.recordings.inventory import Inventory, TopicRecord
from bagassets.recordings.rewinds import Rewind


def watched_topics(rig: Rig) -> dict[str, str]:
    """Return topic -> channel, signal or `ego_pose`, for the topics that a dataset of this rig needs."""
    sources = [*sorted(rig.channels.items()), *sorted(rig.signals.items())]
    watched = {source.topic: name for name, source in reversed(sources)}
    pose_topic = getattr(rig.ego_pose, "topic", None)
    if pose_topic is not None:
        watched[pose_topic] = "ego_pose"
    return dict(sorted(watched.items()))


def channels_present(rig: Rig, inventory: Inventory, check: ChannelsCheck) -> Finding:
    """Check that each configured channel and signal has readable messages in the recording, and that the rig is that of one robot.

    A channel without any drops no keyframe: samples are made without it.
    """
    problems = []
    absent = []
    for name, channel in [*sorted(rig.channels.items()), *sorted(rig.signals.items())]:
        record = inventory.topics.get(channel.topic)
        if record is not None and record.count and record.problem is None:
            continue
        absent.append(name)
        if name in check.optional:
            continue
        if record is None:
            reason = "is not in the recording"
        elif not record.count:
            reason = "has no messages"
        else:
            reason = f"cannot be read: {record.problem}"
        lacks = f"its samples lack {name} (rigs[].required skips such recordings)"
        problems.append(
            f"{name}: topic {channel.topic} {reason}, so {lacks if name in rig.channels else 'it has no such signal'}"
        )
    problems += [
        f"annotations: topic {source.topic} is not in the recording"
        for source in rig.annotations
        if source.topic not in inventory.topics
    ]
    problems += _several_robots(rig, inventory)
    return Finding(problems, {"channels": len(rig.channels), "absent": absent})


def _several_robots(rig: Rig, inventory: Inventory) -> list[str]:
    """Return what is wrong if a rig has topics of several robots that were recorded together."""
    recorded = {name: (one.msgtype, one.frame_ids) for name, one in inventory.topics.items() if one.count}
    robots = robots_of(recorded)
    read = [*watched_topics(rig).items(), (getattr(rig.ego_pose, "imu", None) or "", "ego_pose")]
    read += [(source.topic, "annotations") for source in rig.annotations]
    read += [(topic, "tf") for topic in (*rig.tf, *rig.tf_static)]
    whose: dict[str, set[str]] = {}
    for topic, what in read:
        if topic in recorded and (robot := robot_of(topic, robots)) is not None:
            whose.setdefault(robot, set()).add(what)
    if len(whose) < 2:
        return []
    parts = [
        f"{', '.join(sorted(names))} of {robot or 'the one without namespace'}"
        for robot, names in sorted(whose.items())
    ]
    return [
        f"the rig mixes robots that were recorded together: {'; '.join(parts)}; give it the topics of one"
    ]


def recording_whole(inventory: Inventory) -> Finding:
    """Check that nothing of the recording is damaged."""
    damage = inventory.damage
    if damage is None:
        return Finding([], {"damaged": False})
    return Finding(list(damage.sentences()), {"damaged": True, "lost": sum(damage.lost.values())})


def topic_rates(rig: Rig, inventory: Inventory, check: TopicsCheck) -> Finding:
    """Check mean rates and longest pauses of topics, by log time."""
    problems = []
    rates: dict[str, float | None] = {}
    for topic in sorted({*watched_topics(rig), *check.limits}):
        limits = check.limits.get(topic, TopicLimits())
        record = inventory.topics.get(topic)
        if record is None or not record.count:
            if limits.required:
                problems.append(f"{topic}: has no messages in the recording, but is required in checks")
            continue
        rates[topic] = record.rate_hz
        problems += _rate_problems(record, limits)
        max_gap_s = check.max_gap_s if limits.max_gap_s is None else limits.max_gap_s
        if record.max_gap_s is not None and record.max_gap_s > max_gap_s:
            problems.append(_gap_problem(record, max_gap_s))
    return Finding(problems, {"rates_hz": rates})


def _rate_problems(record: TopicRecord, limits: TopicLimits) -> list[str]:
    rate_hz, low_hz, high_hz = record.rate_hz, limits.min_hz, limits.max_hz
    rate = f"{record.count} message has no rate" if rate_hz is None else f"{rate_hz:g} Hz"
    if low_hz is not None and (rate_hz is None or rate_hz < low_hz):
        return [f"{record.name}: {rate}, at least {low_hz:g} Hz expected"]
    if high_hz is not None and rate_hz is not None and rate_hz > high_hz:
        return [f"{record.name}: {rate}, at most {high_hz:g} Hz expected"]
    return []


def _gap_problem(record: TopicRecord, max_gap_s: float) -> str:
    expected, longest_s = f"at most {max_gap_s:g} s expected", record.max_gap_s or 0.0
    first = next((gap for gap in record.gaps if gap.duration_s > max_gap_s), None)
    if first is None:
        return f"{record.name}: a pause of {_span(longest_s)}, {expected}"
    longest = "" if longest_s == first.duration_s else f", the longest lasts {_span(longest_s)}"
    return f"{record.name}: a pause of {_span(first.duration_s)} after {clock(first.start_ns)}{longest}; {expected}"


def _span(seconds: float) -> str:
    """Return a time span with a fitting unit."""
    for size, unit in ((86_400, "days"), (3_600, "hours")):
        if seconds >= 2 * size:
            return f"{seconds / size:.1f} {unit}"
    return f"{seconds:g} s"


def rewind_text(rewind: Rewind) -> str:
    """Return what is wrong where log times go back as they were written."""
    places = "once" if rewind.times == 1 else f"{rewind.times} times, at first"
    return (
        f"Log times go back {places} from {clock(rewind.from_ns)} to {clock(rewind.to_ns)} in the order in which they were "
        "written, as if a simulation was reset or a clock set back, and messages from before and after are mixed; record each run by itself"
    )


def stamps_monotonic(
    rig: Rig, inventory: Inventory, check: StampsCheck, clock_of: Callable[[str], Clock] = lambda _: "header"
) -> Finding:
    """Check that log times go forward as written, and that header stamps do and agree with them, where `clock_of` a channel or signal says that these count."""
    problems = [] if inventory.rewind is None else [rewind_text(inventory.rewind)]
    backward: dict[str, int] = {}
    offsets_s: dict[str, float] = {}
    for topic, name in watched_topics(rig).items():
        record = inventory.topics.get(topic)
        if record is None or clock_of(name) == "log":
            continue
        number, first_ns = record.unordered_stamps, record.first_unordered_ns
        if number:
            backward[topic] = number
        if number > check.max_backward:
            first = "" if first_ns is None else f", the first to {clock(first_ns)}"
            verb = "goes" if number == 1 else "go"
            problems.append(f"{topic}: {number} of {record.count} header stamps {verb} back in time{first}")
        offset = record.header_offset_s
        if offset is not None and abs(offset.median) <= check.max_offset_s:
            offsets_s[topic] = offset.median - getattr(rig.channels.get(name), "stamp_offset_s", 0.0)
        elif offset is not None:
            side = "before" if offset.median > 0 else "after"
            problems.append(
                f"{topic}: header stamps are {_span(abs(offset.median))} {side} the log time, "
                f"at most {check.max_offset_s:g} s expected"
            )
    topics = sorted(offsets_s, key=offsets_s.__getitem__)
    apart_s = offsets_s[topics[-1]] - offsets_s[topics[0]] if topics else 0.0
    if apart_s > check.max_apart_s:
        problems.append(
            f"{topics[0]}: by the log times, its stamps are {apart_s:.3g} s ahead of those of {topics[-1]}, at most "
            f"{check.max_apart_s:g} s expected; if a clock was off, `stamp_offset_s` of a lidar corrects it, or use `clock: log`"
        )
    return Finding(problems, {"backward": backward})
