"""What a recording's episodes are made from: the parameters of the asset `lerobot_episodes`, and what its actions read."""

from dataclasses import dataclass
from pathlib import Path

from bagassets.assets.asset import Facts, Use, inlined, omitted
from bagassets.assets.frames import FRAMES
from bagassets.assets.signals import SIGNALS
from bagassets.base.errors import DatasetError
from bagassets.decode.video import decoder_version
from bagassets.formats.lerobot.frames import Rule
from bagassets.formats.lerobot.ranges import Span, by_file
from bagassets.formats.lerobot.settings import Cuts, Encoding, LeRobot, TaskTopic
from bagassets.formats.lerobot.video import with_defaults
from bagassets.recipe.model import Recipe, Rig

USUAL_TOLERANCE_FRAMES = 1.5


@dataclass(frozen=True)
class FeatureParams:
    """Where a feature is from; see `lerobot.features` in the recipe."""

    name: str
    signals: tuple[str, ...]
    camera: str | None
    next_of: str | None
    rule: Rule


@dataclass(frozen=True)
class EpisodesParams:
    """The recipe's parameters for a recording's part of the LeRobot dataset.

    The task that the recipe gives all episodes is not among them: it is written when they are joined.

    Attributes:
        rig: name of the rig.
        fps: frames per second.
        features: in the order of the recipe.
        cuts: where episodes are.
        has_ranges: a file of time ranges says so.
        ranges: that file.
        task: topic and field of the task; None if no messages say it.
        video: how videos are encoded.
    """

    rig: str
    fps: int
    features: tuple[FeatureParams, ...]
    cuts: Cuts
    has_ranges: bool
    task: tuple[str, str | tuple[str, ...]] | None
    video: Encoding
    ranges: Path | None

    @property
    def holds_nearest(self) -> bool:
        """True if a feature gets its nearest value, and holds one in a gap."""
        return any((one.rule.at, one.rule.gap) == ("nearest", "hold") for one in self.features)

    @property
    def holds_once(self) -> bool:
        """True if no frame can be held for two signals of a feature, or lie behind the end of its episode."""
        ends = any(one.rule.gap == "end" for one in self.features)
        return not any(one.rule.gap == "hold" and (ends or len(one.signals) > 1) for one in self.features)

    @classmethod
    def of(cls, recipe: Recipe, rig: Rig) -> "EpisodesParams":
        """Return the parameters for a rig; without features if it has not all that they are made from."""
        settings = recipe.settings(LeRobot)
        if settings is None:
            raise TypeError("the recipe has no LeRobot dataset")
        has_all = all(
            rig.signals.keys() >= {*one.signals} and one.camera in {None, *rig.channels}
            for one in settings.features.values()
        )
        features = []
        for name, one in settings.features.items() if has_all else ():
            rule = Rule(one.at, one.tolerance_s or USUAL_TOLERANCE_FRAMES / settings.fps, one.gap)
            features.append(FeatureParams(name, one.signals, one.camera, one.next_of, rule))
        task = settings.task
        return cls(
            rig=rig.name,
            fps=settings.fps,
            features=tuple(features),
            cuts=Cuts(**settings.episodes.model_dump(exclude={"ranges"})),
            has_ranges=settings.episodes.ranges is not None,
            task=(task.topic, task.field) if isinstance(task, TaskTopic) else None,
            video=with_defaults(settings.video),
            ranges=settings.episodes.ranges,
        )


@dataclass(frozen=True, kw_only=True)
class EpisodesUse:
    """All that determines a recording's episodes besides its signals, images and messages.

    Attributes:
        params: from the recipe.
        start_ns: where the recording begins.
        end_ns: where it ends.
        spans: its episodes in the file of time ranges; None without such a file.
    """

    params: EpisodesParams = inlined(without=("ranges",))
    start_ns: int
    end_ns: int
    spans: tuple[Span, ...] | None = omitted()


def use(params: EpisodesParams, facts: Facts) -> dict[str, Use[EpisodesUse] | Exception]:
    """Return what a recording's episodes depend on.

    Raises:
        DecodeError: PyAV is not installed.
        DatasetError: the recording lacks a signal or a camera of a feature, or a topic; the file of ranges cannot be read.
    """
    if not params.features:
        return {"": Use(EpisodesUse(params=params, start_ns=0, end_ns=0), (), {})}
    if any(one.camera for one in params.features):
        decoder_version("lerobot.features")
    inventory, cuts = facts.inventory, params.cuts
    inputs, found = {}, {asset: facts.channels(asset) for asset in (SIGNALS.name, FRAMES.name)}
    wanted = [(one.name, SIGNALS.name, name) for one in params.features for name in one.signals]
    wanted += [(one.name, FRAMES.name, one.camera) for one in params.features if one.camera]
    wanted += [("its episodes", SIGNALS.name, cuts.signal)] if cuts.signal else []
    for feature, asset, name in wanted:
        if name not in found[asset]:
            raise DatasetError(
                f"{feature} needs {name}, of which this recording has no messages; name it in bags.exclude, and "
                "give recordings like it a project of their own."
            )
        inputs[f"{asset}:{name}"] = found[asset][name].digest
    topics = {name for name in (cuts.topic, params.task and params.task[0]) if name}
    start_ns = inventory.start_ns or 0
    spans = None
    if params.ranges is not None:
        try:
            content = facts.file(params.ranges)
        except OSError as err:
            raise DatasetError(
                f"{params.ranges}: the file of time ranges cannot be read ({err.strerror}); correct "
                "lerobot.episodes.ranges in the recipe."
            ) from err
        spans = tuple(by_file(content, params.ranges, facts.key, start_ns))
    return {
        "": Use(
            EpisodesUse(params=params, start_ns=start_ns, end_ns=inventory.end_ns or 0, spans=spans),
            tuple(sorted(topic for topic in topics if inventory.has(topic))),
            inputs,
        )
    }
