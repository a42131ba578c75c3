"""The asset `lerobot_episodes`: the episodes of one recording, ready to be joined.

Files: `rows.parquet` with the features of signals in all frames, `videos/FEATURE/NUMBER.mp4`, `episodes.json` with the place,
task, statistics and videos of each episode, `facts.json`.
"""

import os
from collections import Counter
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import cv2
import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from bagassets.assets.asset import Asset, Inputs, Summary, Use
from bagassets.assets.face import Face, Loss
from bagassets.assets.frames import FRAMES
from bagassets.assets.inventory import INVENTORY
from bagassets.assets.pictures.canvas import pixels_in
from bagassets.assets.quality.check import RecordingCheck
from bagassets.assets.quality.finding import Finding
from bagassets.assets.signals import SIGNALS, TABLE
from bagassets.base.alike import names_text
from bagassets.base.errors import DatasetError, DecodeError
from bagassets.base.json_types import JsonMapping, JsonObject
from bagassets.base.quantities import count_text
from bagassets.base.trace import span
from bagassets.formats.format import FACTS
from bagassets.formats.lerobot import statistics
from bagassets.formats.lerobot.cuts import (
    NO_MESSAGES,
    TaskTexts,
    by_events,
    by_signal,
    heard,
    pieces,
    said,
    why_unsaid,
)
from bagassets.formats.lerobot.frames import COUNTED, Frames, Source, frames_of, time_text, whole_span
from bagassets.formats.lerobot.grid import values_at
from bagassets.formats.lerobot.parameters import EpisodesParams, EpisodesUse, use
from bagassets.formats.lerobot.ranges import Span
from bagassets.formats.lerobot.settings import IMAGES, LeRobot
from bagassets.formats.lerobot.video import PYAV, encode, even, header
from bagassets.store.artifact import Artifact, ArtifactWriter
from bagassets.store.canonical import digest_bytes

ROWS, EPISODES = "rows.parquet", "episodes.json"
_MOST_ENCODERS = 8
_MOST_TOPICS = 12  # that are named
_MOST_REPEATED = 0.25  # of the frames
_MOST_CUT = 0.05


@dataclass(frozen=True)
class _Camera:
    """The images of a camera in a recording.

    Attributes:
        channel: its name.
        artifact: has the files.
        files: their names, in order of stamps.
        sizes: height and width, (M, 2).
    """

    channel: str
    artifact: Artifact
    files: Sequence[str]
    sizes: NDArray[np.int32]

    def image(self, index: int) -> NDArray[np.uint8]:
        """Return an image in BGR, (H, W, 3).

        Raises:
            DatasetError: it is not one of 8 bits.
        """
        path = self.artifact.path(self.files[index])
        pixels = pixels_in(path, cv2.IMREAD_UNCHANGED)
        if pixels is None or pixels.dtype != np.uint8:
            what = "unreadable" if pixels is None else f"of {8 * pixels.dtype.itemsize} bits"
            raise DatasetError(
                f"{self.channel}: the image {path.name} is {what}, and videos have images of 8 bits; set `to_8bit` of the camera, "
                "or leave it out of lerobot.features."
            )
        if pixels.ndim == 2:
            pixels = np.repeat(pixels[:, :, None], 3, axis=2)
        return np.asarray(pixels[:, :, :3], dtype=np.uint8)


@dataclass(frozen=True)
class _Episode:
    """An episode that keeps its rules: its task if the recording says it, and its frames."""

    task: str | None
    frames: Frames


class _Maker:
    """Makes the episodes of one recording.

    Attributes:
        sources: what features are made from.
        names: feature -> its elements.
        cameras: feature -> its images.
        left_out: the episodes that break a rule: where they begin, and why.
        why_none: why the recording says of no episode where it is, as a clause; "" if it does.
    """

    def __init__(self, use: Use[EpisodesUse], inputs: Inputs) -> None:
        self._use, self._params = use.params, use.params.params
        self._inputs, self._topics = inputs, use.topics
        self.cameras: dict[str, _Camera] = {}
        self.names: dict[str, list[str]] = {}
        self.sources: list[Source] = []
        self.left_out: list[JsonObject] = []
        self.why_none = ""
        for one in self._params.features:
            for name in one.signals:
                stamps_ns, values, names = self._signal(name)
                self.sources.append(Source(one.name, name, one.rule, stamps_ns, values))
                own = names if len(one.signals) == 1 else [f"{name}.{element}" for element in names]
                self.names.setdefault(one.name, []).extend(own)
            if one.camera:
                artifact = inputs.channels(FRAMES.name)[one.camera]
                index = artifact.read_table("index.parquet", ["stamp_ns", "file", "width", "height"])
                sizes = np.stack([index.column(side).to_numpy() for side in ("height", "width")], axis=1)
                self.cameras[one.name] = _Camera(
                    one.camera, artifact, index.column("file").to_pylist(), sizes
                )
                self.sources.append(
                    Source(one.name, one.camera, one.rule, index.column("stamp_ns").to_numpy())
                )

    def _signal(self, name: str) -> tuple[NDArray[np.int64], NDArray[np.float64], list[str]]:
        """Return stamps, values and elements of a signal, without the times at which an element has no value."""
        table = self._inputs.channels(SIGNALS.name)[name].read_table(TABLE)
        names = table.column_names[1:]
        values = np.stack([table.column(one).to_numpy(zero_copy_only=False) for one in names], axis=1)
        complete = (np.abs(values) <= np.finfo(np.float32).max).all(axis=1)  # of what rows hold; NaN is not
        return table.column("stamp_ns").to_numpy()[complete], values[complete], names

    def episodes(self) -> list[_Episode]:
        """Return the episodes that keep their rules."""
        if not self.sources:
            self.why_none = f"rig {self._params.rig} has not all signals and cameras of lerobot.features"
            return []
        empty = next((source for source in self.sources if not len(source.stamps_ns)), None)
        if empty is not None:
            self._leave_out(self._use.start_ns, f"{empty} has no complete value")
            return []
        spans, texts = self._asked()
        made: list[_Episode] = []
        cuts, params = self._params.cuts, self._params
        for piece in (piece for one in spans for piece in pieces(one, cuts.max_length_s, params.fps)):
            try:
                task = piece.task or (None if texts is None else texts.of(piece))
                frames = frames_of(
                    piece, self.sources, params.fps, cuts.trim_s, cuts.min_length_s, self._use.start_ns
                )
                self._check_sizes(frames, made)
                made.append(_Episode(task, frames))
            except DecodeError as err:
                self._leave_out(piece.start_ns, str(err))
        return made

    def _asked(self) -> tuple[Sequence[Span], TaskTexts | None]:
        """Return where episodes shall be, and the tasks if messages say them."""
        cuts, topics = self._params.cuts, self._topics
        with self._inputs.messages(topics) as recording:
            spans: Sequence[Span] = self._use.spans or ()
            why_none = "the file of time ranges does not name it"
            if cuts.topic is not None:
                events = said(recording, cuts.topic, cuts.field) if cuts.topic in topics else []
                spans = by_events(events, cuts.start, cuts.end, self._use.end_ns)
                why_none = why_unsaid(recording, cuts.topic, cuts.field, events) or (
                    f"no message of {cuts.topic} begins one: they say {heard(events)}; correct `start`"
                )
            elif cuts.signal is not None:
                stamps_ns, values, names = self._signal(cuts.signal)
                if len(names) != 1:
                    raise DatasetError(
                        f"signal {cuts.signal} has the elements {', '.join(names)}, but one that says where episodes "
                        "are has one; correct lerobot.episodes.signal."
                    )
                spans = by_signal(stamps_ns, values[:, 0])
                why_none = f"signal {cuts.signal} is always zero"
            elif not self._params.has_ranges:
                spans = [whole_span(self.sources)]
            self.why_none = "" if spans else why_none
            if self._params.task is None:
                return spans, None
            topic, field = self._params.task
            texts = said(recording, topic, field) if topic in topics else []
            return spans, TaskTexts(texts, self._use.start_ns, why_unsaid(recording, topic, field, texts))

    def _check_sizes(self, frames: Frames, made: Sequence[_Episode]) -> None:
        """Refuse an episode whose images have another size than those before.

        Raises:
            DecodeError: they have.
        """
        for feature, camera in self.cameras.items():
            sizes = camera.sizes[self._images(feature, frames)]
            first = sizes[0] if not made else camera.sizes[self._images(feature, made[0].frames)[0]]
            other = np.flatnonzero((sizes != first).any(axis=1))
            if len(other):
                at_s = (frames.times_ns[other[0]] - self._use.start_ns) / 1e9
                height, width = sizes[other[0]]
                raise DecodeError(
                    f"the images of {feature} are {width} x {height} from {at_s:.3f} s on, and {first[1]} x {first[0]} before"
                )

    def _images(self, feature: str, frames: Frames) -> NDArray[np.int64]:
        number = next(n for n, source in enumerate(self.sources) if source.feature == feature)
        return frames.picked[number].before

    def _leave_out(self, start_ns: int, why: str) -> None:
        self.left_out.append({"at_s": round((start_ns - self._use.start_ns) / 1e9, 3), "why": why})

    def values(self, frames: Frames) -> dict[str, NDArray[np.float32]]:
        """Return the features of signals in the frames of an episode, (N, D) each, in the order of the recipe."""
        found: dict[str, NDArray[np.float32]] = {}
        columns: dict[str, list[NDArray[np.float64]]] = {}
        for source, picked in zip(self.sources, frames.picked, strict=True):
            if source.values is not None:
                columns.setdefault(source.feature, []).append(values_at(source.values, picked))
        for one in self._params.features:
            if one.signals:
                found[one.name] = np.concatenate(columns[one.name], axis=1).astype(np.float32)
        number = self.length(frames)
        for one in self._params.features:
            if one.next_of:
                found[one.name] = found[one.next_of][1:]
        return {one.name: found[one.name][:number] for one in self._params.features if not one.camera}

    def length(self, frames: Frames) -> int:
        """Return the number of frames that an episode keeps: its last one has no next one."""
        return len(frames.times_ns) - any(one.next_of is not None for one in self._params.features)

    def film(self, out: ArtifactWriter, number: int, feature: str, frames: Frames) -> JsonObject:
        """Write the video of a camera for one episode; return its facts."""
        chosen = self._images(feature, frames)[: self.length(frames)]
        sampled = set(statistics.sampled_frames(len(chosen)).tolist())
        levels = np.zeros((3, statistics.LEVELS), dtype=np.int64)
        settings, camera = self._params.video, self.cameras[feature]

        def images() -> Iterator[NDArray[np.uint8]]:
            last, image = -1, np.zeros((0, 0, 3), dtype=np.uint8)
            for place, index in enumerate(chosen.tolist()):
                if index != last:
                    image, last = even(camera.image(index), settings.odd_size), index
                if place in sampled:
                    levels[:] += statistics.histogram(statistics.thinned(image)[..., ::-1])
                yield image

        import av  # noqa: PLC0415  (an extra, and 0.1 s)

        try:
            with span("video", channel=feature):
                data = encode(images(), self._params.fps, settings)
        except av.FFmpegError as err:
            asked = f"{settings.codec} with preset {settings.preset} and crf {settings.crf}"
            raise DatasetError(
                f"{feature}: its video cannot be encoded as {asked} ({err.strerror}); correct lerobot.video in the recipe."
            ) from err
        name = f"videos/{feature}/{number:06d}.mp4"
        out.write(name, data)
        height, width = even(camera.image(int(chosen[0])), settings.odd_size).shape[:2]
        return {
            "file": name,
            "size": len(data),
            "header": digest_bytes(header(data).encode()),
            "height": height,
            "width": width,
            "images": len(sampled),
            "levels": levels.tolist(),
        }


def make(use: Use[EpisodesUse], inputs: Inputs, out: ArtifactWriter) -> Summary:
    """Write the recording's episodes; return the summary."""
    params, maker = use.params.params, _Maker(use, inputs)
    made = maker.episodes()
    with ThreadPoolExecutor(
        min(_MOST_ENCODERS, os.cpu_count() or 1), "video"
    ) as pool:  # encoders leave Python to others
        films = [
            {name: pool.submit(maker.film, out, number, name, one.frames) for name in maker.cameras}
            for number, one in enumerate(made)
        ]
        rows: dict[str, list[NDArray[np.float32]]] = {}
        episodes: list[JsonObject] = []
        for number, one in enumerate(made):
            values = maker.values(one.frames)
            for name, column in values.items():
                rows.setdefault(name, []).append(column)
            times_ns = one.frames.times_ns
            length = maker.length(one.frames)
            episodes.append(
                {
                    "start_ns": int(times_ns[0]),
                    "end_ns": int(times_ns[length - 1]),
                    "length": length,
                    "task": one.task,
                    "statistics": {
                        name: {what: value.tolist() for what, value in statistics.of_values(column).items()}
                        for name, column in values.items()
                    },
                    "videos": {name: film.result() for name, film in films[number].items()},
                    **one.frames.counts,
                }
            )
    out.write_json(EPISODES, episodes, indent=None)
    columns = {name: np.concatenate(parts) for name, parts in rows.items()}
    if columns:
        out.write_table(ROWS, pa.table({name: as_column(values) for name, values in columns.items()}))
    frames = sum(one["length"] for one in episodes)
    # What only some count is left out where none does: their artifacts stay as they were.
    counted = dict.fromkeys([*COUNTED, *(what for one in made for what in one.frames.counts)])
    facts = {
        "rig": params.rig,
        "fps": params.fps,
        "episodes": len(episodes),
        "frames": frames,
        "duration_s": frames / params.fps,
        "features": _specifications(maker, params, columns, episodes),
        "left_out": maker.left_out,
        "why_none": maker.why_none,
        **{
            what: dict(sum((one.frames.counts.get(what, Counter()) for one in made), Counter()))
            for what in counted
        },
    }
    out.write_json(FACTS, facts)
    shown = ("episodes", "frames", "left_out", "why_none", *counted)
    return {name: facts[name] for name in shown}


def as_column(values: NDArray[np.float32]) -> pa.Array:
    """Return a feature as a column: numbers if it has one element, as readers expect, else lists of a fixed size."""
    flat = pa.array(np.ascontiguousarray(values).ravel())
    return flat if values.shape[1] == 1 else pa.FixedSizeListArray.from_arrays(flat, values.shape[1])


def _specifications(
    maker: _Maker,
    params: EpisodesParams,
    columns: dict[str, NDArray[np.float32]],
    episodes: Sequence[JsonMapping],
) -> JsonObject:
    """Return feature -> type, shape and names of elements, in the order of the recipe; empty without episodes."""
    found: JsonObject = {}
    for one in params.features if episodes else ():
        if one.camera:
            film = episodes[0]["videos"][one.name]
            names = ["height", "width", "channels"]
            found[one.name] = {"dtype": "video", "shape": [film["height"], film["width"], 3], "names": names}
        else:
            names = maker.names[one.next_of or one.name]
            found[one.name] = {"dtype": "float32", "shape": [columns[one.name].shape[1]], "names": names}
    return found


def _losses(summary: JsonMapping) -> list[Loss]:
    return [
        Loss("lerobot_episodes", f"{time_text(one['at_s'])}: {one['why']}", 1, "episode")
        for one in summary.get("left_out", ())
    ]


def _with_setting(why: str) -> str:
    """Return why an episode is left out, with a setting that artifacts do not name."""
    if why.endswith("raise its tolerance_s") and not why.startswith(IMAGES):
        return f"{why}, or set `at: hold` if each value holds until the next"
    if "has no value within" in why and "raise its" not in why:
        return f"{why}; `gap` of the feature can end the episode there, or hold the value before"
    if ", more than " in why:
        return f"{why} (lerobot.episodes.trim_s)"
    is_set = " and must have " in why and not why.endswith(" 2")  # which any episode must have
    return f"{why} (lerobot.episodes.min_length_s)" if is_set else why


def _all_kept(summary: JsonMapping, topics: Sequence[str]) -> Finding:
    """Report the episodes that were left out, and why there is none to begin with."""
    left_out = summary["left_out"]
    problems = []
    for one in left_out:
        when = time_text(one["at_s"])
        begins = when if "before" in when else f"at {when}"
        problems.append(f"the episode that begins {begins} is left out: {_with_setting(one['why'])}")
    why_none = summary.get("why_none")  # not in artifacts of before
    there = f"; there are {names_text(topics, _MOST_TOPICS)}" if str(why_none).endswith(NO_MESSAGES) else ""
    warnings = [f"no episodes: {why_none}{there}"] if why_none else []
    frames = summary["frames"]
    for name in (name for name in summary["repeated"] if name.startswith(IMAGES)):
        repeated = summary["repeated"][name] - summary["held"].get(name, 0)
        if repeated > _MOST_REPEATED * frames:
            warnings.append(
                f"{name}: {repeated} of {frames} frames repeat the image before: the camera is slower than lerobot.fps, or jitters, for "
                "which there is `at: nearest`"
            )
    for name, cut in summary.get("cut", {}).items():
        if cut > _MOST_CUT * (frames + cut):
            warnings.append(
                f"{name}: {count_text(cut, 'frame')} behind a gap left out, by its `gap: end`; {frames} are kept"
            )
    return Finding(problems, {"episodes": summary["episodes"], "left_out": len(left_out)}, warnings)


LEROBOT_EPISODES = Asset(
    name="lerobot_episodes",
    version=6,
    changes={
        2: "ends an episode of a file of ranges before the frame at its end",
        3: "holds the value before a gap, though the one after it is nearer",
        4: "counts the frames behind a gap that ends an episode",
        5: "takes a length for whole frames though it is rounded in binary",
        6: "counts a held frame once, and only if it is kept",
    },
    spared={
        3: lambda use: not use.params.holds_nearest,
        4: lambda use: all(one.rule.gap != "end" for one in use.params.features),
        5: lambda use: all(
            length_s * use.params.fps % 1 == 0
            for length_s in (use.params.cuts.min_length_s, use.params.cuts.max_length_s or 0)
        ),
        6: lambda use: use.params.holds_once,
    },
    libraries=(PYAV, "opencv-python-headless", "pyarrow"),
    title="This recording's episodes for the LeRobot dataset: rows, videos and statistics.",
    description="""Videos are encoded once; datasets are joined from them by copying packets. Episodes that break a rule of the recipe
are left out, with the reason.""",
    kinds=frozenset({"parquet", "video"}),
    face=Face(
        counts={"episodes": lambda summary: summary.get("episodes")},
        losses=_losses,
    ),
    reads=(INVENTORY, FRAMES, SIGNALS),
    enabled=lambda recipe: recipe.settings(LeRobot) is not None,
    optional=True,
    params=EpisodesParams.of,
    use=use,
    make=make,
    checks=(
        RecordingCheck(
            "episodes_kept",
            "channels_present",
            "The recording has episodes for the LeRobot dataset, and none was left out.",
            "an episode breaks a rule of `lerobot.features` or `lerobot.episodes`, or nothing says where one is; more than a quarter of the frames "
            "repeat the image before; the message says why (section `channels_present`)",
            lambda e: _all_kept(e.artifact("lerobot_episodes").summary(), sorted(e.inventory.topics)),
            quick=True,
        ),
    ),
)
