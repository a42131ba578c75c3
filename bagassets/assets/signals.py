"""The asset `signals`: series of numbers from the fields of messages.

Files of one signal: `signal.parquet` with the column `stamp_ns` and one for each element, `signal.json`.
"""

from array import array
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from bagassets.assets.asset import Asset, Facts, Use, inlined, omitted, uses_of
from bagassets.assets.channel import Counts, losses, settings_of, written
from bagassets.assets.face import Face, Table
from bagassets.assets.inventory import INVENTORY
from bagassets.assets.quality.channel_rules import channels_complete
from bagassets.assets.quality.check import RecordingCheck
from bagassets.assets.quality.signal_rules import signal_values
from bagassets.base.errors import DecodeError, LossLimitError, UnsetError
from bagassets.base.json_types import Json, JsonMapping, JsonObject
from bagassets.decode.numeric_fields import Numbers, numbers_at, own_stamp_ns
from bagassets.recipe.model import Recipe, Rig
from bagassets.recipe.model_base import Clock
from bagassets.recipe.model_signals import STAMP
from bagassets.recordings.model import RawMessage
from bagassets.recordings.recording import Recording
from bagassets.store.artifact import Artifact, ArtifactWriter

TABLE, FACTS = "signal.parquet", "signal.json"
REPEATED, OTHER_NUMBER = "repeated stamp", "it has another number of elements than before"


@dataclass(frozen=True, kw_only=True)
class SignalSettings:
    """Settings of one signal in the recipe.

    Attributes:
        topic: topic of its messages.
        fields: paths of the fields.
        names: its elements in order; empty for all of the first message.
        unit: unit of the values.
        factor: what recorded values are multiplied by.
        clock: which time of a message is its stamp.
        lost_messages: share of the messages that may fail to decode.
    """

    topic: str
    fields: tuple[str, ...]
    names: tuple[str, ...]
    unit: str | None
    factor: float = omitted(1.0)
    clock: Clock
    lost_messages: float


@dataclass(frozen=True)
class SignalsParams:
    """Parameters of `signals`: signal -> its settings."""

    signals: Mapping[str, SignalSettings]

    @classmethod
    def of(cls, recipe: Recipe, rig: Rig) -> "SignalsParams":
        """Return the parameters of a rig."""
        signals = {}
        for name, one in sorted(rig.signals.items()):
            own = {"fields": one.fields, "factor": one.factor, "clock": recipe.clock_of(rig, one)}
            signals[name] = settings_of(SignalSettings, {**dict(recipe.limits), **dict(one), **own})
        return cls(signals)


@dataclass(frozen=True)
class SignalUse:
    """Everything besides its messages that shapes a signal: its name and its settings."""

    signal: str
    settings: SignalSettings = inlined()

    def __str__(self) -> str:
        return f"{self.signal} ({self.settings.topic})"


def use(params: SignalsParams, facts: Facts) -> dict[str, Use[SignalUse] | Exception]:
    """Return what each signal in a recording depends on."""
    present = {name: one for name, one in params.signals.items() if facts.inventory.has_readable(one.topic)}
    return uses_of(present, lambda name, one: Use(SignalUse(name, one), (one.topic,)))


class Elements:
    """The elements of a signal, and where they are in each message.

    Args:
        settings: the signal.
        first: the numbers in each field of the first message that has any.

    Attributes:
        names: the elements, in order.
    """

    def __init__(self, settings: SignalSettings, first: Sequence[Numbers]) -> None:
        self._given = settings.names
        self._single = len(settings.fields) == 1
        self._fields = settings.fields
        self._by_name = any(part.named for part in first)
        labels = self._labels(first)
        if settings.names and self._by_name:
            labels = tuple(
                label
                for path, part in zip(settings.fields, first, strict=True)
                for label in ([self._named(path, n) for n in settings.names] if part.named else part.labels)
            )
        elif settings.names and len(settings.names) == len(labels):
            labels = settings.names
        elif settings.names:
            raise UnsetError("it has another number of elements than `names` in the recipe, and names none")
        self.names = labels
        self._places: dict[tuple[str, ...], tuple[list[int], list[int]]] = {}

    def row(self, parts: Sequence[Numbers]) -> tuple[NDArray[np.float64], NDArray[np.bool_]] | None:
        """Return the values of a message and which it lacks, (N,) each; None if it has none of the elements.

        Raises:
            UnsetError: elements without names have another number than before.
        """
        labels = self._labels(parts)
        values = np.concatenate([part.values for part in parts])
        if not self._by_name:
            if len(values) != len(self.names) or any(part.named for part in parts):
                raise UnsetError(OTHER_NUMBER)
            return values, np.zeros(len(values), dtype=np.bool_)
        if labels not in self._places:
            if not any(part.named for part in parts):
                raise UnsetError("it does not name its elements")
            where = {label: index for index, label in enumerate(labels)}
            to = [index for index, name in enumerate(self.names) if name in where]
            self._places[labels] = [where[self.names[index]] for index in to], to
        source, to = self._places[labels]
        if not to:
            return None
        row = np.full(len(self.names), np.nan)
        absent = np.ones(len(self.names), dtype=np.bool_)
        row[to], absent[to] = values[source], False
        return row, absent

    def _labels(self, parts: Sequence[Numbers]) -> tuple[str, ...]:
        if self._single:
            return parts[0].labels
        return tuple(
            self._named(path, label) if part.named else label
            for path, part in zip(self._fields, parts, strict=True)
            for label in part.labels
        )

    def _named(self, path: str, name: str) -> str:
        return name if self._single else f"{path}.{name}"


class SignalExtractor:
    """Turns the messages of one topic into a signal.

    Messages are sorted by stamp; of several with one stamp the first counts. A value that is not finite, or that a message
    lacks, is null. Messages that name other elements only, as where two drivers share a topic, are none of the signal's.

    Args:
        use: everything that shapes it.
        recording: decodes the messages.
        out: writes the artifact.
    """

    def __init__(self, use: SignalUse, recording: Recording, out: ArtifactWriter) -> None:
        self.topics: tuple[str, ...] = (use.settings.topic,)
        self._use = use
        self._recording = recording
        self._out = out
        self._counts = Counts()
        self._elements: Elements | None = None
        self._stamps = array("q")
        self._values = array("d")
        self._absent = bytearray()
        self._failed = 0
        self._others: Counter[str] = Counter()  # names that messages of others have
        self._other_messages = 0
        self._labels: tuple[str, ...] = ()
        self._changes: list[int] = []

    def add(self, message: RawMessage) -> None:
        """Take the next message; one that gives no values is counted as lost."""
        settings = self._use.settings
        try:
            decoded = self._recording.decode(message)
            parts = [numbers_at(decoded, path) for path in settings.fields]
            stamp_ns = message.log_time_ns if settings.clock == "log" else own_stamp_ns(decoded)
            if self._elements is None:
                self._elements = Elements(settings, parts)
            found = self._elements.row(parts)
        except DecodeError as err:
            self._counts.read += 1
            self._counts.lose(str(err))
            self._failed += not isinstance(err, UnsetError)
            return
        labels = tuple(label for part in parts for label in part.labels)
        if found is None:
            self._others.update(labels)
            self._other_messages += 1
            return
        self._counts.read += 1
        if labels != self._labels:
            if self._labels and sorted(labels) != sorted(self._labels):
                self._changes.append(stamp_ns)
            self._labels = labels
        values, absent = found
        self._stamps.append(stamp_ns)
        self._values.frombytes(values.tobytes())
        self._absent += absent.tobytes()

    def finish(self) -> JsonObject:
        """Write the signal; return the summary.

        Raises:
            LossLimitError: more messages failed to decode than the recipe allows, or none has the elements.
        """
        settings, counts = self._use.settings, self._counts
        if self._elements is None or not self._stamps:
            raise LossLimitError(self._nothing())
        if self._failed > settings.lost_messages * counts.read:
            raise LossLimitError(
                f"{self._use}: {self._failed} of {counts.read} messages give no values, most often because "
                f"{counts.main_reason}. If that is acceptable, raise limits.lost_messages in the recipe; else correct the signal."
            )
        names = self._elements.names
        stamps_ns = np.frombuffer(self._stamps, dtype=np.int64)
        order = np.argsort(stamps_ns, kind="stable")
        ordered_ns = stamps_ns[order]
        kept = order[np.diff(ordered_ns, prepend=ordered_ns[0] - 1) > 0]
        counts.written = len(kept)
        if len(kept) < len(order):
            counts.lose(REPEATED, len(order) - len(kept))
        values = np.frombuffer(self._values, dtype=np.float64).reshape(-1, len(names))[kept] * settings.factor
        absent = np.frombuffer(self._absent, dtype=np.bool_).reshape(-1, len(names))[kept]
        never = [name for name, missing in zip(names, absent.T, strict=True) if missing.all()]
        if never:
            raise LossLimitError(self._lacking(never))
        null = ~np.isfinite(values)
        columns = [
            pa.array(column, mask=gap) for column, gap in zip(values.T.copy(), null.T.copy(), strict=True)
        ]
        schema = pa.schema({STAMP: pa.int64(), **dict.fromkeys(names, pa.float64())})
        entry = self._out.write_table(TABLE, pa.table([pa.array(stamps_ns[kept]), *columns], schema=schema))
        steps_ns = np.diff(stamps_ns)
        finite = np.where(null, np.nan, values)
        facts: JsonObject = {
            "counts": counts.as_json()
            | {
                "missing": int(absent.sum()),
                "not_finite": int((null & ~absent).sum()),
                "backward": int((steps_ns < 0).sum()),
                "others": self._other_messages,
                "changes": len(self._changes),
            }
        }
        self._out.write_json(
            FACTS,
            {
                "signal": self._use.signal,
                "topic": settings.topic,
                "unit": settings.unit,
                "first_change_ns": self._changes[0] if self._changes else None,
                "most_backward_s": max(0, -int(steps_ns.min(initial=0))) / 1e9,
                "elements": [
                    {
                        "name": name,
                        "missing": int(absent[:, index].sum()),
                        "not_finite": int((null & ~absent)[:, index].sum()),
                        **_span_of(finite[:, index]),
                    }
                    for index, name in enumerate(names)
                ],
                **facts,
            },
        )
        return {**facts, "messages": counts.read, "bytes": entry.size}

    def _nothing(self) -> str:
        """Return why there is no value at all."""
        if self._counts.lost:
            return (
                f"{self._use}: none of its {self._counts.read} messages gives values, most often because "
                f"{self._counts.main_reason}. Correct the signal in the recipe, or remove it."
            )
        return self._lacking(self._use.settings.names)

    def _lacking(self, names: Sequence[str]) -> str:
        known = ", ".join(sorted({*self._others, *self._labels})) or "none"
        wanted = ", ".join(names) or "any number"
        return f"{self._use}: no message has {wanted}; they have {known}. Correct `names` of the signal."


def _span_of(values: NDArray[np.float64]) -> JsonObject:
    """Return the smallest and the largest of values, of which some may be NaN."""
    finite = values[np.isfinite(values)]
    ends = (float(finite.min()), float(finite.max())) if len(finite) else (None, None)
    return dict(zip(("min", "max"), ends, strict=True))


def _shown(artifact: Artifact) -> Mapping[str, Json | Table]:
    signals: JsonMapping = artifact.summary()["channels"]
    rows = [
        (
            name,
            counts["read"],
            counts["written"],
            sum(counts["lost"].values()),
            counts["missing"] + counts["not_finite"],
            counts["backward"],
        )
        for name, counts in sorted(signals.items())
    ]
    return {
        "written": sum(row[2] for row in rows),
        "lost": sum(row[3] for row in rows),
        "signals": Table(("signal", "read", "written", "lost", "empty values", "stamps back in time"), rows),
    }


SIGNALS = Asset(
    name="signals",
    version=1,
    libraries=("pyarrow",),
    title="Series of numbers, such as joint positions and commands: a table of stamps and values each.",
    description="""One artifact per signal, so that a change to one leaves the others alone. Sorted by stamp; a value that is not finite, or that a
message lacks, is null.""",
    kinds=frozenset({"parquet"}),
    face=Face(
        columns=pa.schema({STAMP: pa.int64(), "<element>": pa.float64()}),
        shown=_shown,
        counts={"values": written},
        losses=losses,
    ),
    reads=(INVENTORY,),
    enabled=lambda recipe: any(rig.signals for rig in recipe.rigs),
    params=SignalsParams.of,
    use=use,
    extract=lambda use, _, recording, out, __: SignalExtractor(use.params, recording, out),
    checks=(
        RecordingCheck(
            "signals_complete",
            "channels_present",
            "Every message read was written or counted as lost, and every signal has values.",
            "counts do not add up; more than `limits.reported_losses` (5 %) of the messages of a signal were lost, for whatever "
            "reason (section `channels_present`, whose `max_lost` takes precedence)",
            lambda e: channels_complete(e.channels("signals"), e.max_lost, e.clock_of),
            quick=True,
        ),
        RecordingCheck(
            "signal_values",
            "signal_values",
            "Elements of signals have values all the time, and in the expected range.",
            "an element has no value for more than `max_gap_s` (1 s), or in more than `max_empty` (1 %) of the messages; stamps go "
            "back by more than `max_backward_s` (1 s); a value is outside its `limits`; rates are those of topics (`topic_rates`)",
            lambda e: signal_values(e.parts("signals"), e.checks.signal_values),
        ),
    ),
)
