"""The asset `inventory`: the content of a recording, topic by topic, from one pass over it.

Files: `inventory.json`, and `messages.parquet` with the small messages that other assets read.
"""

from collections import Counter, defaultdict
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack, suppress
from dataclasses import asdict, dataclass, replace
from itertools import compress
from math import inf
from pathlib import Path

import numpy as np

from bagassets.assets.asset import Asset, Facts, Inputs, Summary, Use, for_messages, inlined, omitted
from bagassets.assets.face import Face, Loss, Table
from bagassets.assets.kept_messages import KeptMessages
from bagassets.assets.pose_outliers import trusted_fixes
from bagassets.assets.quality.check import RecordingCheck
from bagassets.assets.quality.finding import clock
from bagassets.assets.quality.topic_rules import (
    channels_present,
    recording_whole,
    rewind_text,
    stamps_monotonic,
    topic_rates,
)
from bagassets.assets.topic_log import TopicLog
from bagassets.base.errors import DecodeError, RecordingError
from bagassets.base.json_types import Json, JsonMapping, JsonObject
from bagassets.base.quantities import count_text
from bagassets.decode.loading import own_decoder
from bagassets.decode.poses import FixReading
from bagassets.decode.registry import bulk_types, own_types
from bagassets.decode.video import codec_in_image
from bagassets.geometry.sun import daylight
from bagassets.recipe.model import READING_LIMITS, Recipe, Recover, Rig
from bagassets.recordings.damage import DamageError, advice_for, unreadable
from bagassets.recordings.model import Format, RawMessage
from bagassets.recordings.pack import PACK_SCHEMA, write_pack
from bagassets.recordings.recording import Recording
from bagassets.recordings.salvage.damage_map import VERSION as SALVAGE_VERSION
from bagassets.recordings.salvage.damage_map import Damage, DamageMap, losses_text
from bagassets.recordings.topic import ForeignBytes, RefusedBytes, Topic
from bagassets.store.artifact import Artifact, ArtifactWriter

# Header stamps farther than this from the log time are noted.
MOST_OFFSET_S = 1.0
_DAY_NS = 86_400_000_000_000
# A single damaged message does not make its topic unreadable.
MOST_MISFITS = 5


@dataclass(frozen=True)
class InventoryParams:
    """Parameters of `inventory`, the same for all rigs.

    Attributes:
        definitions: folders of `.msg` files, for recordings without message definitions.
        limits: memory limits that differ from the defaults. Messages that they exclude change the digests of topics,
            and so the actions of all assets that read these.
        recover: what becomes of damaged recordings.
    """

    definitions: tuple[Path, ...]
    limits: Mapping[str, int]
    recover: Recover = omitted("complete")

    @classmethod
    def of(cls, recipe: Recipe, _: Rig) -> "InventoryParams":
        """Return the parameters of a recipe."""
        limits = recipe.limits.changed(*READING_LIMITS)
        return cls(recipe.bags.message_definitions, limits, recipe.bags.recover)


@dataclass(frozen=True)
class InventoryUse:
    """What shapes an inventory besides the content of the recording.

    Attributes:
        format: format in which the recording is read: the same bytes with another suffix are read differently.
        limits: as in `InventoryParams`.
        salvage: of a recording that the ordinary readers refuse: the version of those that read it, and `recover`.
        recover: as in `InventoryParams`; it matters only with `salvage`.
        refused: why the ordinary readers refuse it.
    """

    format: Format
    limits: Mapping[str, int] = inlined()
    salvage: Mapping[str, Json] | None = omitted()
    recover: Recover = for_messages("complete")
    refused: str = for_messages("")


def use(params: InventoryParams, facts: Facts) -> dict[str, Use[InventoryUse]]:
    """Return what the inventory of a recording depends on: all of it, and the definitions of message types."""
    inputs = {"bag": facts.digest, **facts.definitions(params.definitions)}
    return {"": Use(InventoryUse(facts.format, params.limits, recover=params.recover), inputs=inputs)}


def _fallback(use: Use[InventoryUse], refused: str) -> Use[InventoryUse] | None:
    """Return what is read of a recording that the ordinary readers have refused; None if it is refused once and for all."""
    params = use.params
    if params.recover == "refuse" or params.salvage is not None:
        return None
    salvage = {"version": SALVAGE_VERSION, "recover": params.recover}
    return replace(use, params=replace(params, salvage=salvage, refused=refused))


def make_inventory(
    recording: Recording, out: ArtifactWriter, *, size: int, recover: Recover = "all", why: str = ""
) -> JsonObject:
    """Read the whole recording once, write its inventory and pack, and return the summary.

    Args:
        recording: the recording.
        out: writes the artifact.
        size: bytes of the recording's files.
        recover: what becomes of a damaged recording.
        why: why the ordinary readers refuse it.

    Raises:
        RecordingError: messages are missing, or more is damaged than `recover` accepts.
    """
    logs = {name: TopicLog(info.msgtype) for name, info in recording.topics.items()}
    readable = {name: info for name, info in recording.topics.items() if info.problem is None}
    bulk = bulk_types("yes")
    probes = {
        name: _TopicProbe(info, MOST_MISFITS if info.msgtype in bulk else inf)
        for name, info in readable.items()
    }
    kept = KeptMessages(name for name, info in readable.items() if info.msgtype not in bulk)
    fixes: dict[str, list[tuple[int, FixReading]]] = defaultdict(list)
    fix_types = own_types("fix")
    refused: Counter[tuple[str, str]] = Counter()
    recording.check_content()
    unprobed = dict(probes)
    for number, message in enumerate(recording.messages(list(recording.topics))):
        name, msgtype, _, data = message
        info = readable.get(name)
        if isinstance(data, RefusedBytes):
            refused[name, data.reason] += 1
        logs[name].add(message, None if info is None else info.header(data))
        probe = unprobed.get(name)
        if probe is not None and not isinstance(data, ForeignBytes) and probe.add(message):
            del unprobed[name]
        kept.add(number, message)
        if info is not None and msgtype in fix_types:
            with suppress(DecodeError):  # the receiver had no fix
                fix = own_decoder("fix", info.msgtype)(info.decode(data))
                fixes[name].append((message.log_time_ns, fix))
    # Nothing is lost silently.
    missing = {
        name: info.count - logs[name].count - recording.repeated[name]
        for name, info in recording.topics.items()
    }
    damage = None if recording.damage is None else _damage_of(recording, logs, missing, recover, why)
    for name, info in sorted(recording.topics.items()):
        if damage is None and missing[name] > 0:
            raise RecordingError(
                f"{recording.path}: topic {name}: only {logs[name].count} of the {info.count} messages that the "
                f"recording's own index announces were found; {advice_for(recording.path)}."
            )
    write_pack(out, kept.in_order())
    problems = {
        name: probes[name].problem if name in probes else info.problem
        for name, info in recording.topics.items()
    }
    videos = {name: probe.video for name, probe in probes.items() if probe.video is not None}
    value = _inventory_json(recording, logs, kept.topics, problems, videos, fixes)
    for (name, reason), number in sorted(refused.items()):
        value["notes"].append(
            f"{name}: {number} of {logs[name].count} messages cannot be used, each because {reason}."
        )
    if damage is not None:
        value["notes"] += damage.sentences()
        value["damage"] = damage.as_json()
    elif (rewind := recording.rewind()) is not None:
        value["notes"].append(f"{rewind_text(rewind)}.")
        value["rewind"] = asdict(rewind)
    out.write_json("inventory.json", value | {"size": size})
    return {
        "messages": sum(topic["count"] for topic in value["topics"]),
        "topics": len(value["topics"]),
        "duration_s": value["duration_s"],
        "unreadable_topics": ", ".join(sorted(name for name in problems if problems[name])) or "none",
        **({} if damage is None else {"damage": damage.share(), "lost": dict(damage.lost)}),
    }


def _damage_of(
    recording: Recording,
    logs: Mapping[str, TopicLog],
    missing: Mapping[str, int],
    recover: Recover,
    why: str,
) -> DamageMap:
    """Return the damage map of a recording that has been read.

    Raises:
        RecordingError: more is damaged than `recover` accepts.
    """
    noted = recording.damage or Damage()
    damage = noted.map(missing, sum(log.count for log in logs.values()))
    if damage.read and (recover == "all" or damage.is_complete):
        return damage
    refused = why or str(unreadable(recording.path, DamageError("it is damaged")))
    if not damage.read:
        raise RecordingError(refused)
    raise RecordingError(
        f"{refused.rstrip('.')}; or use what is whole, with `recover: all` in bags of the recipe: {damage.share()}. "
        f"`bagassets doctor` shows what is lost."
    )


def _inventory_json(
    recording: Recording,
    logs: dict[str, TopicLog],
    packed: set[str],
    problems: dict[str, str | None],
    videos: Mapping[str, str],
    fixes: Mapping[str, list[tuple[int, FixReading]]],
) -> JsonObject:
    topics = []
    for name, info in sorted(recording.topics.items()):
        definition = info.definition
        topics.append(
            {
                "name": name,
                "type": info.msgtype,
                **logs[name].as_json(info.layout_digest),
                "packed": name in packed,
                "problem": problems[name],
                "serialization": info.serialization,
                "definition": {"format": definition.format, "text": definition.text},
                **({"video": videos[name]} if name in videos else {}),
            }
        )
    starts = [topic["first_ns"] for topic in topics if topic["first_ns"] is not None]
    ends = [topic["last_ns"] for topic in topics if topic["last_ns"] is not None]
    start, end = (min(starts), max(ends)) if starts else (None, None)
    span_ns = 0 if start is None or end is None else end - start
    place, strays = _place_of(fixes)
    jumps = [] if span_ns <= _DAY_NS else _jumps(logs)
    return {
        "format": recording.format,
        "start_ns": start,
        "end_ns": end,
        "duration_s": round(span_ns / 1e9, 6),
        "topics": topics,
        **place,
        "notes": [*_notes(recording, topics), *strays, *jumps],
    }


def _place_of(fixes: Mapping[str, Sequence[tuple[int, FixReading]]]) -> tuple[JsonObject, list[str]]:
    """Return where the recording was made, and whether by day: `gnss` and `daylight` in the form of `inventory.json`, and notes about strays.

    Args:
        fixes: topic -> log time in nanoseconds and content of each fix; header stamps may not be set.
    """
    good, notes = [], []
    for topic, read in sorted(fixes.items()):
        places = np.array([(fix.lat_deg, fix.lon_deg, fix.alt_m) for _, fix in read])
        trusted = trusted_fixes(np.array([at for at, _ in read], np.int64), *places.T)
        good += list(compress(read, trusted))
        strays = len(read) - int(np.count_nonzero(trusted))
        if strays:
            notes.append(
                f"{topic}: {strays} of {len(read)} fixes {'is' if strays == 1 else 'are'} out of reach from the others, "
                "which tell place and daylight."
            )
    if not good:
        return {"gnss": None, "daylight": None}, notes
    good.sort(key=lambda item: item[0])
    first, last = good[0][1], good[-1][1]
    gnss = {"first": _fix_json(first), "last": _fix_json(last)}
    return {"gnss": gnss, "daylight": daylight(first.lat_deg, first.lon_deg, first.stamp_ns)}, notes


def _fix_json(fix: FixReading) -> JsonObject:
    alt = None if fix.alt_m != fix.alt_m else fix.alt_m
    return {"lat": fix.lat_deg, "lon": fix.lon_deg, "alt": alt, "stamp_ns": fix.stamp_ns}


def _jumps(logs: Mapping[str, TopicLog]) -> Iterator[str]:
    """Yield a note on the longest time without any message, if it is longer than a day."""
    times_ns = np.sort(np.concatenate([log.times_ns for log in logs.values()]))
    gaps_ns = np.diff(times_ns)
    longest = int(np.argmax(gaps_ns))
    if gaps_ns[longest] > _DAY_NS:
        yield (
            f"Log times jump by {gaps_ns[longest] / _DAY_NS:.1f} days after {clock(int(times_ns[longest]))}: the clock was set while "
            "recording, or the recorder paused, so duration and rates are not those of the drive."
        )


def _notes(recording: Recording, topics: list[JsonObject]) -> list[str]:
    """Return sentences about what is unusual, with a single one for all topics that share it."""
    notes = []
    unset, apart = [], []
    for topic in topics:
        name, offset = topic["name"], topic["header_offset_s"]
        if topic["problem"] is not None:
            notes.append(f"{name} cannot be decoded: {topic['problem']}.")
        if repeated := recording.repeated[name]:
            them = f"{count_text(repeated, 'message')} that the recorder repeated in later parts"
            notes.append(f"{name}: {them} count{'s' if repeated == 1 else ''} once.")
        announced = recording.topics[name].count - repeated
        if announced != topic["count"]:
            notes.append(f"{name}: the recording announces {announced} messages and holds {topic['count']}.")
        if back := topic["unordered_stamps"]:
            goes = "goes" if back == 1 else "go"
            notes.append(f"{name}: {count_text(back, 'header stamp')} {goes} back in time.")
        if offset is None or topic["problem"] is not None:
            continue
        if topic["first_stamp_ns"] == topic["last_stamp_ns"] == 0:
            unset.append(name)
        elif abs(offset["median"]) > MOST_OFFSET_S:
            apart.append(f"{name} ({offset['median']:+.1f} s)")
    if unset:
        notes.append(f"Header stamps are all zero on {', '.join(unset)}: only the log time tells when.")
    if apart:
        notes.append(
            f"Log times are far from header stamps on {', '.join(apart)}: choose the clock in the recipe with care."
        )
    return notes


def _make(use: Use[InventoryUse], inputs: Inputs, out: ArtifactWriter) -> Summary:
    params = use.params
    with ExitStack() as stack:
        try:
            recording = stack.enter_context(inputs.whole(salvaged=params.salvage is not None))
        except RecordingError as err:
            if err.transient or not params.refused:
                raise
            raise RecordingError(params.refused) from err  # nothing is there: what ordinary readers say of it
        return make_inventory(recording, out, size=inputs.size, recover=params.recover, why=params.refused)


class _TopicProbe:
    """Decodes the first messages of a topic, until one fits its definition.

    If a type has several possible layouts, all messages are decoded: empty lists, for example, fit
    any layout.

    Attributes:
        video: codec of the video that messages for images hold; None if they hold images.

    Args:
        topic: the topic, whose type is known.
        most_misfits: how many must not fit before it gives up; of small messages, which are used from the pack, all.
    """

    def __init__(self, topic: Topic, most_misfits: float) -> None:
        self._topic = topic
        self._most_misfits = most_misfits
        self._misfits = 0
        self._reason = ""
        self._fits = False
        self.video: str | None = None

    def add(self, message: RawMessage) -> bool:
        """Take the next message; return whether no more are needed."""
        try:
            decoded = self._topic.decode(message.data)
        except DecodeError as err:
            self._misfits += 1
            self._reason = str(err)
        else:
            self._fits = True
            self.video = codec_in_image(decoded, message.msgtype)
        enough = self._fits or self._misfits == self._most_misfits
        return enough and not self._topic.is_ambiguous

    @property
    def problem(self) -> str | None:
        """Why its messages cannot be decoded; None if one was decoded, or if there were none."""
        if self._fits or not self._misfits:
            return None
        if not self._reason.startswith("its bytes do not fit"):
            return f"none of its messages can be decoded: {self._reason}"
        msgtype = self._topic.msgtype
        if self._topic.has_definition:
            return f"its messages do not fit the definition of {msgtype} that is in the recording"
        return (
            f"its messages fit no definition of {msgtype} that is known; name a folder of .msg files in "
            "bags.message_definitions"
        )


def _shown(artifact: Artifact) -> Mapping[str, Json | Table]:
    rows = []
    for topic in artifact.read_json("inventory.json")["topics"]:
        rate = "" if topic["rate_hz"] is None else f"{topic['rate_hz']:.4g} Hz"
        rows.append((topic["name"], topic["type"], topic["count"], rate, topic["problem"] or ""))
    topics = Table(("topic", "type", "messages", "rate", "problem"), rows)
    damage = artifact.read_json("inventory.json").get("damage")
    damaged = {} if damage is None else {"damaged": _damaged(DamageMap.from_json(damage))}
    summary = {name: value for name, value in artifact.summary().items() if name != "lost"}
    return {**damaged, "contents": topics, **summary}


def _damaged(damage: DamageMap) -> Table:
    rows = [("", "", "", finding, "") for finding in damage.findings]
    for hole in damage.holes:
        times = [clock(at) if at is not None else "?" for at in (hole.start_ns, hole.end_ns)]
        lost = "?" if hole.lost is None else losses_text(hole.lost)
        rows.append((hole.file, f"{hole.begin} to {hole.end}", " to ".join(times), hole.reason, lost))
    return Table(("file", "bytes", "log times", "what is damaged", "lost"), rows)


def _losses(summary: JsonMapping) -> list[Loss]:
    reason = "in damaged parts of the recording"
    return [
        Loss(topic or "topics that are not known", reason, n) for topic, n in summary.get("lost", {}).items()
    ]


INVENTORY = Asset(
    name="inventory",
    version=11,
    changes={
        7: "lists topics that metadata.yaml leaves out, and knows stray fixes and clocks that were set",
        8: "reads messages in protobuf and JSON, and the stamps of Foxglove's in ROS 2",
        9: "notes where log times go back, and the codec of video in CompressedImage",
        10: "knows the packets of Ouster's driver where no definitions were recorded",
        11: "knows the packets of Hesai's drivers where no definitions were recorded",
    },
    # Definitions are always recorded in bags of ROS 1 and bare MCAPs.
    spared={8: lambda use: use.format == "ros1", **dict.fromkeys((10, 11), lambda use: use.format != "ros2")},
    # rosbags has the standard types, which recordings without definitions are decoded with.
    libraries=("pyarrow", "rosbags"),
    title="What is in the recording: topics, types, counts, rates, gaps, offsets between clocks, the place, day or night.",
    description="""Has a digest of each topic, so that other assets depend on just the topics that they read, and packs the small messages
for them: `inventory.json`, `messages.parquet`.""",
    kinds=frozenset({"json", "parquet"}),
    face=Face(columns=PACK_SCHEMA, shown=_shown, losses=_losses, heading="invent."),
    params=InventoryParams.of,
    use=use,
    make=_make,
    fallback=_fallback,
    checks=(
        RecordingCheck(
            "recording_whole",
            "recording_whole",
            "Nothing of the recording is damaged.",
            "parts of the recording cannot be read, or it lacks its index; the sentences say what is lost",
            lambda e: recording_whole(e.inventory),
        ),
        RecordingCheck(
            "channels_present",
            "channels_present",
            "Every configured channel has readable messages in the recording, and all are of one robot.",
            "a configured channel has no readable messages, so samples lack it (unless listed as `optional`); channels, poses, "
            "boxes or TF are of several robots that were recorded together",
            lambda e: channels_present(e.rig, e.inventory, e.checks.channels_present),
        ),
        RecordingCheck(
            "topic_rates",
            "topic_rates",
            "Topics of channels and poses keep to their rates and make no long pauses.",
            "the mean rate of a topic leaves `min_hz`..`max_hz`; a pause is longer than `max_gap_s`; a `required` topic is "
            "not there",
            lambda e: topic_rates(e.rig, e.inventory, e.checks.topic_rates),
        ),
        RecordingCheck(
            "stamps_monotonic",
            "stamps_monotonic",
            "Log times go forward as they were written; so do header stamps of channels and poses, and agree with log times, if it "
            "is not `clock: log` that counts.",
            "log times go back as they were written, so that two runs are mixed; more than `max_backward` header stamps go back in time; the median stamp is more than `max_offset_s` from "
            "the log time, or those of two topics differ in that by more than `max_apart_s`",
            lambda e: stamps_monotonic(e.rig, e.inventory, e.checks.stamps_monotonic, e.clock_of),
        ),
    ),
)
