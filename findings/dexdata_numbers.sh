#!/usr/bin/env bash
# An episode at 12.5 Hz, with an evenly coloured camera image and a depth image in metres (surfaces at 3 m, 0.1 m and 0.7 m, and one without a return), becomes a LeRobot dataset (v2.1) with dexdata, as
# it is set up. Which times and pixels has it, and by which statistics would a policy normalise them? Guess: times of 12.5 Hz, statistics of these pixels; depth of 0.2 to 1.2 m in 8 bits, and
# "values outside (or 0/NaN) become the uint8 invalid sentinel 0", as its help says. Seen with dexdata 0.1.0 on 2026-11-30, without a word:
# - statistics of EVERY image, depth too, are those of CLIP's training (mean 0.481, 0.458, 0.408), typed in, with a minimum of 0 and a maximum of 1 and the count of frames; here
#   the mean is 0.784, 0.196, 0.078, the deviation 0
# - 3 m is 255, a surface at 1.2 m; only what is nearer than 0.2 m is 0
# - the table has 12.5 Hz, and the video 12: picture 24 is at 2.0 s, its row at 1.92 s, and they part by 2.5 s a minute
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check torch==2.13.0 numpy==2.4.6 av==18.1.0 pyarrow==26.0.1 jsonlines==4.0.0 loguru==0.7.3 pyyaml==6.0.4 \
  tenacity==9.2.1 mcap==1.6.0 protobuf==7.36.2 foxglove-schemas-protobuf==0.4.0 tyro==1.0.17 uuid6==2025.0.1 tqdm==4.70.1 pillow==13.0.0 imageio-ffmpeg==0.8.1 \
  opencv-python-headless==5.0.0.93
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check --no-deps dexdata==0.1.0
cd "$folder"
ln -s "$(venv/bin/python -c 'import imageio_ffmpeg; print(imageio_ffmpeg.get_ffmpeg_exe())')" ffmpeg  # which dexdata calls by its name
cat >convert.py <<'PYTHON'
import json
import types
from pathlib import Path

import av
import numpy as np
import pyarrow.parquet as pq

COLOUR, FRAMES = (200, 50, 20), 25


def frames(root, camera):
    """Return time and pixels of each frame of a camera."""
    with av.open(str(next(root.rglob(f"*{camera}/*.mp4")))) as container:
        return [(frame.time, frame.to_ndarray(format="rgb24")) for frame in container.decode(video=0)]


def main():
    from dexdata.exporters import lerobot
    from dexdata.exporters.canonical import CanonicalBundle, DepthConfig, ExporterConfig, RGBConfig

    depth = np.full((FRAMES, 48, 64), 0.7, np.float32)
    depth[:, :12], depth[:, 12:24], depth[:, 24:36] = 3.0, 0.1, 0.0
    arrays = {
        "observation.state.arm": np.arange(FRAMES, dtype=np.float32)[:, None],
        "observation.images.head.rgb": np.full((FRAMES, 48, 64, 3), COLOUR, np.uint8),
        "observation.images.head.depth": depth,
    }
    names = types.SimpleNamespace(collection=types.SimpleNamespace(record_hz=12.5), robot=types.SimpleNamespace(embodiment="arm"))
    root = Path("dataset").resolve()
    config = ExporterConfig(RGBConfig(), DepthConfig(out_hw=(48, 64)))
    lerobot.write([CanonicalBundle(arrays, names, FRAMES)], root, config=config, task="reach")

    stats = json.loads((root / "meta/episodes_stats.jsonl").read_text())["stats"]
    colour, far = stats["observation.images.head.rgb"], stats["observation.images.head.depth"]
    print("statistics of the camera:", colour, "- of depth the same:", colour == far)
    assert np.round(colour["mean"], 3).ravel().tolist() == [0.481, 0.458, 0.408] and colour == far
    assert np.abs(np.mean([pixels for _, pixels in frames(root, "rgb")], axis=(0, 1, 2)) - COLOUR).max() < 4
    shown = [int(frames(root, "depth")[0][1][row, 32, 0]) for row in (6, 18, 30, 42)]
    print("3 m, 0.1 m, no return and 0.7 m are", shown)
    assert shown[0] > 250 and max(shown[1:3]) < 5 and 120 < shown[3] < 132
    rate = json.loads((root / "meta/info.json").read_text())["fps"]
    row_s = pq.read_table(next(root.rglob("*.parquet")))["timestamp"].to_pylist()[-1]
    picture_s = frames(root, "rgb")[-1][0]
    print("fps:", rate, "- the last row is at", row_s, "s, its picture at", picture_s, "s")
    assert rate == 12.5 and np.isclose(row_s, 1.92) and np.isclose(picture_s, 2.0)


if __name__ == "__main__":
    main()
PYTHON
PATH=$folder:$PATH venv/bin/python -W ignore convert.py 2>errors.txt || { tail -5 errors.txt; exit 1; }
