#!/usr/bin/env bash
# Cameras of 10 Hz, with a pause of 5 s in the middle: colour, with an alpha channel in the order of a driver (bgra8), 16 bits of a thermal camera (mono16), depth in millimetres and in
# metres. `mcap-to-mp4` makes a video of each topic. Guess: frames at their times, with the pause; what it does not know is refused.
# Seen with mcap-to-mp4 0.6.0 on 2026-11-30, as it is set up, without a word:
# - frames lie evenly between the first and the last: the tenth, of 0.9 s, is at 3.27 s. (`--timestamp-timing` is there for their times; it wants a program `ffmpeg`)
# - what matters is the number of bytes of a pixel, whatever the encoding: of 16 bits the LOW byte is the brightness, so that 1280 mm are black and 1535 mm white; depth in metres is a
#   picture in colour, of the bytes of its floats; bgra8 has blue for red
# - mono8 ends in a TypeError
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
python3 -m venv venv
venv/bin/pip install --quiet --disable-pip-version-check mcap-to-mp4==0.6.0 rosbags==0.11.9 pillow==11.3.0 av==13.1.0 numpy==2.4.6
cat > write.py <<'PYTHON'
from pathlib import Path

import numpy as np
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

store = get_typestore(Stores.ROS2_HUMBLE)
types, image = store.types, "sensor_msgs/msg/Image"
PIXELS = {
    "rgb8": lambda _: np.uint8([200, 40, 30]),
    "bgra8": lambda _: np.uint8([30, 40, 200, 255]),
    "mono16": lambda number: np.uint16([0x8000 + (10 if number % 2 else 240)]),
    "16UC1": lambda number: np.uint16([1535 if number % 2 else 1280]),
    "32FC1": lambda _: np.float32([1.1]),
    "mono8": lambda _: np.uint8([7]),
}
with Writer(Path("drive"), version=9, storage_plugin=StoragePlugin.MCAP) as writer:
    for encoding, pixel in PIXELS.items():
        topic = writer.add_connection(f"/{encoding}", image, typestore=store)
        for number in [*range(10), *range(60, 70)]:
            pixels = np.tile(pixel(number), (64, 64, 1))
            stamp = types["builtin_interfaces/msg/Time"](1_700_000_000 + number // 10, number % 10 * 100_000_000)
            header = types["std_msgs/msg/Header"](stamp, "camera")
            message = types[image](header, 64, 64, encoding, 0, pixels.strides[0], pixels.view(np.uint8).ravel())
            writer.write(topic, stamp.sec * 10**9 + stamp.nanosec, store.serialize_cdr(message, image))
PYTHON
venv/bin/python write.py
for encoding in rgb8 bgra8 mono16 16UC1 32FC1 mono8; do
  venv/bin/mcap-to-mp4 drive/drive.mcap -t "/$encoding" -o "$encoding.mp4" > "$encoding.txt" 2>&1 || true
done
cat > read.py <<'PYTHON'
from pathlib import Path

import av
import numpy as np


def frames(encoding):
    """Return times in seconds and colours in the middle of a video."""
    with av.open(f"{encoding}.mp4") as container:
        read = list(container.decode(video=0))
    print(encoding, [round(float(frame.time), 2) for frame in read[8:12]], [frame.to_ndarray(format="rgb24")[32, 32].tolist() for frame in read[:2]])
    return [float(frame.time) for frame in read], [frame.to_ndarray(format="rgb24")[32, 32].astype(int) for frame in read]


times_s, colours = frames("rgb8")
assert len(times_s) == 20
assert np.allclose(np.diff(times_s), 6.9 / 19, atol=0.01)
assert abs(times_s[9] - 3.27) < 0.01
assert np.abs(colours[0] - [200, 40, 30]).max() < 8
assert np.abs(frames("bgra8")[1][0] - [30, 40, 200]).max() < 8
for encoding, even, odd in (("mono16", 240, 10), ("16UC1", 0, 255)):
    colours = frames(encoding)[1]
    assert np.abs(np.subtract(colours[:2], [[even] * 3, [odd] * 3])).max() < 8
assert np.ptp(frames("32FC1")[1][0]) > 50
assert "TypeError" in Path("mono8.txt").read_text()
assert not any(word in Path(f"{name}.txt").read_text() for name in ("rgb8", "16UC1", "32FC1") for word in ("arning", "rror"))
PYTHON
venv/bin/python read.py
