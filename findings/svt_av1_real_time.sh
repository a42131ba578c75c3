#!/usr/bin/env bash
# In a container, as root, episodes are encoded as AV1 (SVT-AV1, by PyAV; the codec in which LeRobot keeps videos), by a program that then starts others: loaders
# of data, a training. How are they scheduled afterwards? Guess: as before; an encoder minds its own threads.
# Seen with av 18.1.0 (SVT-AV1 in its wheel) on Linux on 2026-11-29, without a word:
# - once the encoder is open, its threads AND the thread that opened it have the real-time policy SCHED_FIFO at 99, the highest priority there is. It
#   stays so when the video is done, and every thread and process that is started from there inherits it
# - such a program is not interrupted for others: on processors that it keeps busy, other programs, a shell among them, get what the kernel
#   keeps back, 5 % by default
# - x264 and libvpx do not; nor does SVT-AV1 for users who may not (without CAP_SYS_NICE)
# Whoever opens the encoder can put its threads (/proc/self/task) back with sched_setscheduler.
set -euo pipefail
[ "$(id -u)" = 0 ] || { echo "to be run by root, as in a container" >&2; exit 2; }
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check av==18.1.0 numpy==2.4.6
SVT_LOG=1 "$folder/venv/bin/python" - <<'PYTHON'
import io
import os
import subprocess
import sys

import av
import numpy as np

CHILD = [sys.executable, "-c", "import os; print(os.sched_getscheduler(0))"]


def encode(codec):
    """Encode five black images; return the policies of all threads while the encoder is open."""
    with av.open(io.BytesIO(), "w", format="mp4") as container:
        stream = container.add_stream(codec, rate=10)
        stream.width = stream.height = 64
        stream.pix_fmt = "yuv420p"
        for _ in range(5):
            image = av.VideoFrame.from_ndarray(np.zeros((64, 64, 3), np.uint8), format="rgb24")
            container.mux(stream.encode(image))
        policies = [os.sched_getscheduler(int(thread)) for thread in os.listdir("/proc/self/task")]
        container.mux(stream.encode())
    return policies


for codec in ("libx264", "libvpx-vp9", "libsvtav1"):
    policies = encode(codec)
    now, child = os.sched_getscheduler(0), int(subprocess.check_output(CHILD))
    priority = os.sched_getparam(0).sched_priority
    print(f"{codec}: {policies.count(os.SCHED_FIFO)} of {len(policies)} threads are real-time ones; afterwards the caller has "
          f"policy {now}, priority {priority}, and a program that it starts policy {child}")
    if codec == "libsvtav1":
        assert policies.count(os.SCHED_FIFO) > 1
        assert (now, priority, child) == (os.SCHED_FIFO, 99, os.SCHED_FIFO)
    else:
        assert {*policies, now, child} == {os.SCHED_OTHER}
PYTHON
