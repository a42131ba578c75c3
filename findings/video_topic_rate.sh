#!/usr/bin/env bash
# A recording (MCAP) of a head camera has foxglove.CompressedVideo: H.264 of an encoder that is set to 30 pictures a second, but in dim light the camera
# gives ten, for two seconds, each with its time in its message. It becomes an MP4 with the devkit of the EgoSuite data set (`lw-egosuite export-video`),
# which copies the stream without encoding it again. When is the last picture? Guess: at 1.9 s, as the messages have times. Seen with lw-egosuite-devkit
# 1.0.2 on 2026-11-29, which says "Exported 20 frame(s)": at 0.63 s. The times are not handed on, so FFmpeg takes the rate that the stream says (25 where
# it says none). A pause is not seen either: with one of 3 s in the middle it is 0.63 s again. Frame numbers are right; times in the video are nobody's.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check --no-deps lw-egosuite-devkit==1.0.2 mcap==1.3.1 mcap-protobuf-support==0.5.4 \
  protobuf==7.36.0 lz4==4.4.5 zstandard==0.25.0 av==15.1.0 numpy==2.4.6 imageio-ffmpeg==0.8.1 foxglove-schemas-protobuf==0.4.0
cd "$folder"
ln -s "$(venv/bin/python -c 'import imageio_ffmpeg; print(imageio_ffmpeg.get_ffmpeg_exe())')" venv/bin/ffmpeg
PATH="$folder/venv/bin:$PATH" venv/bin/python - <<'PYTHON'
from fractions import Fraction
from pathlib import Path

import av
import numpy as np
from foxglove_schemas_protobuf.CompressedVideo_pb2 import CompressedVideo
from lw_egosuite_backend.export_mcap_video import export_video_run
from mcap_protobuf.writer import Writer

PICTURES, STEP_NS = 20, 100_000_000
encoder = av.CodecContext.create("libx264", "w")
encoder.width, encoder.height, encoder.pix_fmt, encoder.time_base = 64, 48, "yuv420p", Fraction(1, 30)
encoder.options = {"tune": "zerolatency", "g": "5", "x264-params": "annexb=1:repeat-headers=1"}
packets = []
for n in range(PICTURES):
    packets += encoder.encode(av.VideoFrame.from_ndarray(np.full((48, 64, 3), 10 * n, np.uint8)))
packets += encoder.encode(None)
assert len(packets) == PICTURES


def seconds_of_video(name, pause_ns):
    """Record the pictures, with a pause in their middle, export them, and return how long the recording and the video are."""
    with open(f"{name}.mcap", "wb") as stream:
        writer = Writer(stream)
        for n, packet in enumerate(packets):
            time_ns = 1_790_000_000_000_000_000 + n * STEP_NS + (pause_ns if n >= PICTURES // 2 else 0)
            message = CompressedVideo(frame_id="head", format="h264", data=bytes(packet))
            message.timestamp.FromNanoseconds(time_ns)
            writer.write_message("/sensor/camera/head_left/video", message, log_time=time_ns, publish_time=time_ns)
        writer.finish()
    assert export_video_run(Path(f"{name}.mcap"), "/sensor/camera/head_left/video", Path(f"{name}.mp4")) == 0
    with av.open(f"{name}.mp4") as video:
        times_s = [float(frame.pts * frame.time_base) for frame in video.decode(video=0)]
    print(f"{name}: {len(times_s)} frames, the last begins at {times_s[-1]:.2f} s, recorded at {(PICTURES - 1) * 0.1 + pause_ns / 1e9:.2f} s")
    return np.array(times_s)


even, pause = seconds_of_video("even", 0), seconds_of_video("pause", 3_000_000_000)
assert np.allclose(even - even[0], np.arange(PICTURES) / 30, atol=1e-3)
assert np.allclose(pause, even)
PYTHON
