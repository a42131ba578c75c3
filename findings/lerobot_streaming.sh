#!/usr/bin/env bash
# A dataset is too large to load, so training streams it. Does StreamingLeRobotDataset give what LeRobotDataset gives for the same arguments?
# Guess: yes, in another order. Seen with lerobot 0.4.4 on 2026-11-28, without a word, in each case (0.6.1 reads the same in its source):
# - `episodes` selects nothing: all are yielded, those held back for validation, too.
# - a picture is looked up at index / fps, in the file that the episode is in. All but the first file begin in the middle of the dataset,
#   so frame 5, the first of the second file, comes with the picture of frame 10; an error is raised once the time is past the file's end.
# - steps beyond the end of an episode repeat the latest step that was asked for, not its last one: with 0, 1, 3 and 4 steps ahead of
#   frame 2 of 5, they are 2, 3, 3, 3 where LeRobotDataset has 2, 3, 4, 4 (both mark the last two as padding).
# It decodes by torchcodec, which is not needed to see this: lerobot's own decoder that takes PyAV stands in for it.
set -euo pipefail
lock=$(cd "$(dirname "$0")/.." && pwd)/requirements-lerobot.lock
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check torch==2.13.0
grep -v '^torch==' "$lock" >"$folder/others.txt"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check --no-deps -r "$folder/others.txt"
cd "$folder"
HF_HUB_OFFLINE=1 HF_HOME="$folder/home" venv/bin/python -W ignore - 2>errors.txt <<'PYTHON' || { tail -5 errors.txt; exit 1; }
import logging

import torch

if torch.version.cuda is None:  # torchvision's wheel lacks an operator then, which lerobot's datasets do not use
    operators = torch.library.Library("torchvision", "DEF")
    operators.define("nms(Tensor dets, Tensor scores, float iou_threshold) -> Tensor")
import lerobot.datasets.streaming_dataset as streaming
import numpy as np
from lerobot.datasets.lerobot_dataset import LeRobotDataset
from lerobot.datasets.video_utils import FrameTimestampError, decode_video_frames

logging.disable(logging.WARNING)
LENGTHS = (5, 20)
CAMERA = "observation.images.camera"
FEATURES = {
    CAMERA: {"dtype": "video", "shape": (48, 64, 3), "names": ["height", "width", "channels"]},
    "action": {"dtype": "float32", "shape": (2,), "names": ["a", "b"]},
}


def by_pyav(path, times_s, tolerance_s, decoder_cache=None):
    return decode_video_frames(path, times_s, tolerance_s, "pyav")


def picture(frame):
    return round((float(frame[CAMERA].mean()) * 255 - 20) / 8)


def streamed(**arguments):
    """Return frames by their index, and whether all came."""
    frames = {}
    try:
        for frame in streaming.StreamingLeRobotDataset("me/x", root="data", shuffle=False, buffer_size=1, **arguments):
            frames[int(frame["index"])] = frame
    except FrameTimestampError:
        return frames, False
    return frames, True


streaming.decode_video_frames_torchcodec = by_pyav
written = LeRobotDataset.create("me/x", fps=10, root="data", features=FEATURES, use_videos=True, vcodec="h264")
written.meta.update_chunk_settings(video_files_size_in_mb=0.001)  # one file for each episode
number = 0
for length in LENGTHS:
    for _ in range(length):
        pixels = np.full((48, 64, 3), 20 + 8 * number, np.uint8)
        written.add_frame({CAMERA: pixels, "action": np.float32([number, number]), "task": "go"})
        number += 1
    written.save_episode()
written.finalize()

whole = LeRobotDataset("me/x", root="data", video_backend="pyav")
assert [picture(whole[i]) for i in range(len(whole))] == list(range(sum(LENGTHS)))
frames, complete = streamed()
seen = {index: picture(frame) for index, frame in sorted(frames.items())}
print("index: picture", seen, "" if complete else "and an error")
assert not complete
assert all(seen[index] == index for index in range(5))
assert all(shown == index + 5 for index, shown in seen.items() if index >= 5) and len(seen) > 10

selected = LeRobotDataset("me/x", root="data", video_backend="pyav", episodes=[0])
frames, _ = streamed(episodes=[0])
print("episodes=[0]:", len(selected), "frames; streamed, of episodes", {int(f["episode_index"]) for f in frames.values()})
assert len(selected) == 5
assert {int(frame["episode_index"]) for frame in frames.values()} == {0, 1}

ahead = {"action": [0, 0.1, 0.3, 0.4]}
frames, _ = streamed(delta_timestamps=ahead)
loaded = LeRobotDataset("me/x", root="data", video_backend="pyav", delta_timestamps=ahead)[2]
values = [frame["action"][:, 0].tolist() for frame in (loaded, frames[2])]
print("frame 2, and 1, 3, 4 ahead:", values[0], "streamed:", values[1])
assert values == [[2, 3, 4, 4], [2, 3, 3, 3]]
assert frames[2]["action_is_pad"].tolist() == loaded["action_is_pad"].tolist() == [False, False, True, True]
PYTHON
