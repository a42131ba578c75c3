"""What becomes of a flipped bit: noticed, without effect, or another file without a word.

Drives of the sample in every format, one random bit flipped in each of many copies, each copy built::

    python -m benchmarks.flips                      # 60 per format, some minutes
    python -m benchmarks.flips --flips 200 --seed 2

The table goes to `benchmarks/results/flips.md`; `docs/operations.md` shows it.
"""

import argparse
import random
import shutil
import sys
import tempfile
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

# Those that are run as files find the package beside them.
sys.path.insert(0, str(Path(__file__).parents[1]))

import cv2
import numpy as np
from mcap.reader import make_reader
from mcap.writer import CompressionType
from mcap.writer import Writer as McapWriter

from bagassets.base.errors import BagAssetsError, DecodeError
from bagassets.decode.compressed_image import checked_size
from bagassets.engine.execute import AssetResult, execute
from bagassets.engine.graph import Graph
from bagassets.formats.catalogue import recording_assets
from bagassets.recipe import load_recipe
from bagassets.recipe.model import Recipe
from bagassets.recordings.digest import recording_digest, recording_stat
from bagassets.recordings.discover import find_one
from bagassets.sample.drive import Target, write_recordings
from bagassets.sample.recipe import sample_recipe
from bagassets.sample.recorder import Compression, RecordingFormat

DURATION_S = 1.2
SEED = 1
IMAGE_FLIPS = 2000
NOTICED, HARMLESS, SILENT = "noticed", "without effect", "silent"


@dataclass(frozen=True)
class Kind:
    """A way to record the drive."""

    name: str
    format: RecordingFormat
    compression: Compression = "none"
    has_crc: bool = True


KINDS = (
    Kind("ROS 1, plain", "ros1"),
    Kind("ROS 1, lz4", "ros1", "lz4"),
    Kind("ROS 1, bz2", "ros1", "bz2"),
    Kind("ROS 2, sqlite3", "ros2"),
    Kind("ROS 2, sqlite3, zstd by message", "ros2", "zstd"),
    Kind("MCAP with CRC", "mcap"),
    Kind("MCAP without CRC", "mcap", has_crc=False),
    Kind("MCAP without CRC, lz4", "mcap", "lz4", has_crc=False),
    Kind("MCAP without CRC, zstd", "mcap", "zstd", has_crc=False),
)


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--flips", type=int, default=60, help="copies per format (default 60)")
    parser.add_argument("--seed", type=int, default=SEED)
    parser.add_argument("--results", type=Path, default=Path(__file__).parent / "results")
    options = parser.parse_args()
    rows = [f"| recorded as | {NOTICED} | {HARMLESS} | {SILENT} |", "|---|--:|--:|--:|"]
    with tempfile.TemporaryDirectory(prefix="flips-", ignore_cleanup_errors=True) as folder:
        for kind in KINDS:
            rows.append(_row(kind.name, flipped_recordings(Path(folder) / "work", kind, options)))
            print(rows[-1], flush=True)
            shutil.rmtree(Path(folder) / "work")
    for name, counts in flipped_images(options.seed):
        rows.append(_row(name, counts))
        print(rows[-1], flush=True)
    options.results.mkdir(exist_ok=True)
    (options.results / "flips.md").write_text("\n".join(rows) + "\n", encoding="utf-8")


def _row(name: str, counts: Counter[str]) -> str:
    return f"| {name} | {counts[NOTICED]} | {counts[HARMLESS]} | {counts[SILENT]} |"


def flipped_recordings(folder: Path, kind: Kind, options: argparse.Namespace) -> Counter[str]:
    """Build copies of one drive with one bit flipped in each; count what became of them."""
    bags = folder / "recordings"
    bags.mkdir(parents=True)
    recipe_file = folder / "recipe.yaml"
    recipe_file.write_text(sample_recipe(), encoding="utf-8")
    recipe = load_recipe(recipe_file)
    suffix = {"ros1": ".bag", "ros2": "", "mcap": ".mcap"}[kind.format]
    drive = bags / f"drive{suffix}"
    write_recordings([Target(drive, kind.format, kind.compression)], SEED, "small", DURATION_S)
    if not kind.has_crc:
        _without_crc(drive, kind.compression)
    files = [drive] if drive.is_file() else sorted(drive.glob("*.db3"))
    whole = _outputs(recipe, drive)
    if not whole.made:
        raise SystemExit(f"{kind.name}: the drive does not build ({whole.problem})")
    chance, counts = random.Random(options.seed), Counter[str]()
    for _ in range(options.flips):
        path = files[0]
        data = bytearray(path.read_bytes())
        at = chance.randrange(len(data))
        data[at] ^= 1 << chance.randrange(8)
        with _changed(path, bytes(data)):
            counts[_verdict(whole, _outputs(recipe, drive))] += 1
    return counts


@contextmanager
def _changed(path: Path, data: bytes) -> Iterator[None]:
    """Let a file have other bytes until the end of the block."""
    before = path.read_bytes()
    path.write_bytes(data)
    try:
        yield
    finally:
        path.write_bytes(before)


@dataclass(frozen=True)
class Outputs:
    """What a build made: asset -> artifact; what it said was lost; why it failed, if it did."""

    made: dict[str, str]
    losses: str
    problem: str | None


def _outputs(recipe: Recipe, drive: Path) -> Outputs:
    made: dict[str, str] = {}
    losses: list[str] = []
    problem = None
    try:
        recording = find_one(drive)
        graph = Graph(
            recording_assets(recipe), replace(recording, key="drive", relative=drive.name),
            recording_digest(recording, rehash=True).digest, recording_stat(recording),
        )  # fmt: skip
        for result in execute(graph):
            if not isinstance(result, AssetResult):
                problem = result.reason
                continue
            # The inventory names every topic's digest, and the previews say what the others do.
            if result.asset == "inventory":
                losses.append(str(result.artifact.summary().get("unreadable_topics")))
            elif result.asset != "preview":
                made[result.asset] = result.artifact.digest
                losses.append(str(_lost(result.artifact.summary())))
    except BagAssetsError as err:
        problem = str(err)
    return Outputs(made, "; ".join(losses), problem)


def _lost(value: Any) -> list[Any]:
    """Return every `lost` of a summary, however deep."""
    if not isinstance(value, dict):
        return []
    return [value.get("lost"), *(found for inner in value.values() for found in _lost(inner))]


def _verdict(whole: Outputs, now: Outputs) -> str:
    if now.problem is not None or now.losses != whole.losses:
        return NOTICED
    return HARMLESS if now.made == whole.made else SILENT


def _without_crc(path: Path, compression: Compression) -> None:
    """Write an MCAP anew, without checksums."""
    before = path.read_bytes()
    with path.open("wb") as stream:
        writer = McapWriter(
            stream,
            compression=CompressionType[compression.upper()],
            enable_crcs=False,
            enable_data_crcs=False,
        )
        writer.start(profile="ros2", library="bagassets benchmark")
        schemas: dict[int, int] = {}
        channels: dict[int, int] = {}
        for schema, channel, message in _messages(before):
            if schema.id not in schemas:
                schemas[schema.id] = writer.register_schema(schema.name, schema.encoding, schema.data)
            if channel.id not in channels:
                channels[channel.id] = writer.register_channel(
                    channel.topic, channel.message_encoding, schemas[schema.id]
                )
            writer.add_message(channels[channel.id], message.log_time, message.data, message.publish_time)
        writer.finish()  # type: ignore[no-untyped-call]  # mcap's has no annotations


def _messages(data: bytes) -> Iterator[tuple[Any, Any, Any]]:
    from io import BytesIO

    yield from make_reader(BytesIO(data)).iter_messages(log_time_order=False)


def flipped_images(seed: int) -> Iterator[tuple[str, Counter[str]]]:
    """Flip bits of one JPEG and one PNG, as in the payload of a message; yield what is noticed of them."""
    rng = np.random.default_rng(seed)
    coarse = rng.integers(0, 255, (45, 80, 3), np.uint8)
    smooth = cv2.resize(coarse, (640, 360), interpolation=cv2.INTER_CUBIC)
    image = np.clip(smooth.astype(int) + rng.integers(-4, 5, smooth.shape), 0, 255).astype(np.uint8)
    for name, extension, kind in (("a JPEG alone", ".jpg", "jpeg"), ("a PNG alone", ".png", "png")):
        encoded = cv2.imencode(extension, image)[1].tobytes()
        pixels = np.asarray(cv2.imdecode(np.frombuffer(encoded, np.uint8), cv2.IMREAD_UNCHANGED))
        counts = Counter[str]()
        for _ in range(IMAGE_FLIPS):
            data = bytearray(encoded)
            data[int(rng.integers(len(data)))] ^= 1 << int(rng.integers(8))
            try:
                checked_size(bytes(data), kind)
            except DecodeError:
                counts[NOTICED] += 1
                continue
            shown = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED)
            if shown is None:
                counts[NOTICED] += 1
            elif shown.shape == pixels.shape and (shown == pixels).all():
                counts[HARMLESS] += 1
            else:
                counts[SILENT] += 1
        yield name, counts


if __name__ == "__main__":
    main()
