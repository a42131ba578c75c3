"""Which recordings one rig made: those whose sensors, frames and pose sources agree."""

import os.path
import re
from collections.abc import Collection, Mapping
from dataclasses import dataclass, field
from itertools import accumulate

from bagassets.propose.frames import propose_ego_frame
from bagassets.propose.poses import SourceKey, odometry_of, pose_candidates
from bagassets.propose.sensors import find_sensors, modality_of, same_sensor
from bagassets.propose.signals import find_signals
from bagassets.propose.summary import RecordingSummary, TopicSummary, merge_recordings
from bagassets.recordings.globs import literal_glob, matches

_ENOUGH_IN_COMMON = 0.5


@dataclass(frozen=True)
class Group:
    """Recordings of one rig.

    Attributes:
        recordings: their paths below the bag root, sorted.
        summary: what they hold together.
        pose_sources: those that all of them have, but for recordings that have none.
    """

    recordings: tuple[str, ...]
    summary: RecordingSummary
    pose_sources: frozenset[SourceKey] = frozenset()


@dataclass
class _Traits:
    """What must agree for recordings to be of one rig.

    Attributes:
        types: sensor topic -> type.
        frames: sensor topic -> frames; topics without frames are left out.
        ego_frame: the ego frame that would be proposed for them; "" if they tell nothing of frames but the sensors'.
        pose_sources: what could be the pose source.
        sensors: names of the topics that a sensor has -> one of them.
    """

    types: dict[str, str]
    frames: dict[str, set[str]] = field(default_factory=dict)
    ego_frame: str = ""
    pose_sources: frozenset[SourceKey] = frozenset()
    sensors: dict[frozenset[str], TopicSummary] = field(default_factory=dict)

    @classmethod
    def of(cls, summary: RecordingSummary) -> "_Traits":
        """Return the traits of one recording; without any if it has neither a usable sensor nor signals."""
        sensors, _ = find_sensors(summary)
        if not sensors:
            return cls(
                {one.topic.name: one.topic.msgtype for one in find_signals(summary) if one.role != "episode"}
            )
        topics = [t for t in summary.topics.values() if t.count > 0 and modality_of(t) is not None]
        odometry = odometry_of(summary)
        ego = propose_ego_frame(summary, sensors, odometry).name
        return cls(
            {topic.name: topic.msgtype for topic in topics},
            {topic.name: set(topic.frames) for topic in topics if topic.frames},
            ego if summary.transforms or (odometry and odometry.child_frames) else "",
            frozenset(source.key for source in pose_candidates(summary, ego)),
            {frozenset({one.topic.name, *one.others}): one.topic for one in sensors},
        )

    def agree(self, other: "_Traits") -> bool:
        """Tell whether another recording is of the same rig: a sensor or the poses may be missing in it."""
        shared = other.types.keys() & self.types.keys()
        if len(shared) < _ENOUGH_IN_COMMON * len(other.types):
            return False
        return (
            all(other.types[topic] == self.types[topic] for topic in shared)
            and all(
                not other.frames[topic].isdisjoint(self.frames[topic])
                for topic in other.frames.keys() & self.frames.keys()
            )
            and (not other.ego_frame or not self.ego_frame or other.ego_frame == self.ego_frame)
            and (
                not other.pose_sources
                or not self.pose_sources
                or not other.pose_sources.isdisjoint(self.pose_sources)
            )
            # A channel has one topic: recorded raw here and compressed there, a camera would be missing from some.
            and not any(
                same_sensor(mine, theirs) and names.isdisjoint(other_names)
                for names, mine in self.sensors.items()
                for other_names, theirs in other.sensors.items()
            )
        )

    def add(self, other: "_Traits") -> None:
        """Take another recording in."""
        self.types |= other.types
        self.sensors |= other.sensors
        for topic, frames in other.frames.items():
            self.frames.setdefault(topic, set()).update(frames)
        self.ego_frame = self.ego_frame or other.ego_frame
        shared = self.pose_sources & other.pose_sources
        self.pose_sources = shared or self.pose_sources or other.pose_sources


def group_recordings(summaries: Mapping[str, RecordingSummary]) -> tuple[list[Group], list[str]]:
    """Return the groups, the one with the most recordings first, and the recordings without a usable sensor.

    A recording joins a group if it shares at least half of its sensor topics, with the same types and frames,
    a topic of each sensor that both have, a pose source and the ego frame: one sensor may be missing without making
    another rig.

    Args:
        summaries: path below the bag root -> what the recording holds.
    """
    traits = {name: _Traits.of(summary) for name, summary in summaries.items()}
    bare = sorted(name for name, own in traits.items() if not own.types)
    known: list[tuple[_Traits, list[str]]] = []
    # Those that tell most come first: what lacks something can then be compared with what it lacks.
    order = sorted(
        (name for name, own in traits.items() if own.types),
        key=lambda name: (-len(traits[name].types), not traits[name].pose_sources, name),
    )
    for name in order:
        for theirs, names in known:
            if theirs.agree(traits[name]):
                theirs.add(traits[name])
                names.append(name)
                break
        else:
            known.append((traits[name], [name]))
    groups = [
        Group(
            tuple(sorted(names)),
            merge_recordings(map(summaries.__getitem__, sorted(names))),
            theirs.pose_sources,
        )
        for theirs, names in known
    ]
    return sorted(groups, key=lambda group: (-len(group.recordings), group.recordings)), bare


def match_globs(recordings: Collection[str], others: Collection[str]) -> list[str]:
    """Return globs that match all of `recordings` and none of `others`, whole folders where possible."""
    if not others:
        return ["**"]
    globs: list[str] = []
    rest: list[str] = []
    for name in sorted(recordings):
        if any(matches(glob, name) for glob in globs):
            continue
        folders = accumulate(name.split("/")[:-1], "{}/{}".format)
        folder = next((f for f in folders if not any(o.startswith(f"{f}/") for o in others)), None)
        if folder is None:
            rest.append(name)
        else:
            globs.append(f"{literal_glob(folder)}/**")
    return sorted(globs + _compact(rest, others))


def _compact(names: list[str], others: Collection[str]) -> list[str]:
    """Return one glob by common beginning if that is unambiguous, else the names themselves."""
    if len(names) > 1:
        common = os.path.commonprefix(names)  # noqa: RUF071  characters are meant
        folder, _, start = common.rpartition("/")
        # A prefix that ends inside a number would not match the next recording of the day.
        start = re.sub(r"\d+$", "", start)
        glob = f"{literal_glob(f'{folder}/{start}' if folder else start)}*"
        if (
            len(start) >= 3
            and all(matches(glob, n) for n in names)
            and not any(matches(glob, o) for o in others)
        ):
            return [glob]
    return [literal_glob(name) for name in names]
