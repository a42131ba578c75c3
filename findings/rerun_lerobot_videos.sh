#!/usr/bin/env bash
# Recordings of Rerun become LeRobot episodes with rerun-lerobot: the camera (H.264, 30 Hz) runs for 5 s, the operator begins to move the arm 2 s after it; state and action are
# logged 30 times a second, or 120 times. Guess: each row has the picture of its time; at `--fps 30` there are 30 rows a second ("`--fps` resamples the scalar streams").
# Seen with rerun-lerobot 0.3.0 on 2026-11-30, without a word; what it gives to lerobot, which is not asked, is looked at here:
# - where the video is copied, which is the default at this rate, the first row is at 0 s, and so is the first PICTURE, of 2 s before: all pictures are 2 s too early, and 2 s of
#   video are left over. Where pictures are made of it (`--output-format png`), each row has its own
# - of 120 rows a second all 360 become rows of a dataset of 30 Hz, which then lasts 12 s, not 3
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
python3.12 -m venv venv
venv/bin/pip install --quiet --disable-pip-version-check datafusion==55.0.0 typing_extensions==4.16.0 av==19.0.2 pyarrow==26.0.1 \
  pandas==3.1.1 tqdm==4.70.1 pillow==13.0.0 numpy==2.5.5 2>/dev/null
venv/bin/pip install --quiet --disable-pip-version-check --no-deps rerun-lerobot==0.3.0 2>/dev/null
cat > episodes.py <<'PYTHON'
import io
import shutil
import sys
from unittest.mock import MagicMock

for name in ("lerobot", "lerobot.configs", "lerobot.configs.video", "lerobot.datasets", "lerobot.datasets.compute_stats", "lerobot.datasets.lerobot_dataset"):
    sys.modules[name] = MagicMock()
sys.modules["rerun"] = sys.modules["rerun.catalog"] = MagicMock()  # its catalogue hands out the table that is made here
import av
import datafusion
import numpy as np
import pyarrow as pa
from rerun_lerobot.camera import ResolvedCamera
from rerun_lerobot.lerobot.converter import convert_dataframe_to_episode
from rerun_lerobot.lerobot.types import LeRobotConversionConfig

HZ, PICTURES, LATE = 30, 150, 60
BEGIN_NS = 1_700_000_000_000_000_000
SCALARS = {"shape": (1,), "dtype": "float32"}


def packets():
    """Return the packets of a video whose pictures are as bright as their numbers."""
    with av.open(io.BytesIO(), "w", format="h264") as container:
        stream = container.add_stream("libx264", HZ)
        stream.width, stream.height, stream.pix_fmt, stream.options = 64, 48, "yuv420p", {"tune": "zerolatency", "g": "30"}
        pictures = [av.VideoFrame.from_ndarray(np.full((48, 64, 3), number, np.uint8)) for number in range(PICTURES)]
        return [bytes(packet) for picture in [*pictures, None] for packet in stream.encode(picture)]


def recording(rows_hz):
    """Return the table of a recording whose action is the number of the picture of its time."""
    rows = [(BEGIN_NS + number * 10**9 // HZ, None, packet) for number, packet in enumerate(packets())]
    count = (PICTURES - LATE) * rows_hz // HZ
    rows += [(BEGIN_NS + 2 * 10**9 + number * 10**9 // rows_hz + 1000, [LATE + number * HZ / rows_hz], None) for number in range(count)]
    times_ns, values, video = zip(*sorted(rows, key=lambda row: row[0]))
    scalars = pa.array(values, pa.list_(pa.float64()))
    columns = {"time": pa.array(times_ns, pa.timestamp("ns")), "/action:Scalars:scalars": scalars, "/state:Scalars:scalars": scalars}
    return datafusion.SessionContext().from_arrow(pa.table(columns | {"/camera:VideoStream:sample": pa.array(video, pa.binary())}))


def converted(table, output):
    """Return what lerobot is given: rows with timestamps and a video, or frames."""
    dataset, episode, frames = MagicMock(), {}, []
    dataset.meta.total_episodes = dataset.meta.total_frames = 0
    dataset.meta.features = {"action": SCALARS, "observation.state": SCALARS, "timestamp": SCALARS}
    dataset.meta.video_keys, dataset.meta.image_keys, dataset.root = ["observation.images.front"], [], "."
    dataset.writer._create_episode_buffer.return_value = {}
    dataset.writer._save_episode_data.side_effect = lambda buffer: episode.update(buffer) or {}
    dataset.writer._save_episode_video.side_effect = lambda key, number, temp_path: shutil.copy(temp_path, "front.mp4") and {}
    dataset.add_frame.side_effect = frames.append
    config = LeRobotConversionConfig(HZ, "time", "/action:Scalars:scalars", "/state:Scalars:scalars", None, [{"key": "front", "path": "/camera"}])
    camera = ResolvedCamera("front", "/camera", "video", "h264", output)
    features = {"action": SCALARS, "observation.state": SCALARS}
    convert_dataframe_to_episode(table, config, lerobot_dataset=dataset, segment_id="episode", features=features, cameras=[camera])
    return episode, frames


rows, _ = converted(recording(HZ), "h264")
with av.open("front.mp4") as container:
    video = [(float(picture.pts * picture.time_base), round(float(picture.to_ndarray(format="rgb24").mean()))) for picture in container.decode(video=0)]
pairs = [(float(action), min(video, key=lambda picture: abs(picture[0] - at))[1]) for at, action in zip(rows["timestamp"], rows["action"])]
print(f"copied: {len(pairs)} rows, {len(video)} pictures; row 0 is of picture {pairs[0][0]:.0f}, and has {pairs[0][1]}; the last is of {pairs[-1][0]:.0f}, and has {pairs[-1][1]}")
assert len(video) == PICTURES and all(abs(right - found - LATE) <= 1 for right, found in pairs)
_, frames = converted(recording(HZ), "png")
off = [frame["action"][0] - frame["observation.images.front"].mean() for frame in frames]
print(f"made anew: {len(frames)} rows, pictures off by {min(off):.1f} to {max(off):.1f}")
assert np.abs(off).max() <= 1.5
_, frames = converted(recording(4 * HZ), "png")
print(f"120 rows a second for 3 s: {len(frames)} rows at {HZ} Hz")
assert len(frames) == 4 * (PICTURES - LATE)
PYTHON
venv/bin/python episodes.py 2> said.txt || { tail -5 said.txt; exit 1; }
if grep -i warn said.txt; then exit 1; fi
