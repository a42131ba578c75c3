#!/usr/bin/env bash
# A drone flies to the north at 10 m/s and films at 30 frames a second; its subtitles (.srt, as DJI writes them) have the position of each frame. srtgeotag takes
# stills out of the video, 1 or 2 a second, and writes the position of each into it. The video's grey levels tell which frame a still is.
# Guess: each still has its own frame's position, to a frame (0.3 m). Seen with srtgeotag 0.2.0 and ffmpeg 7.0.2 on 2026-11-30, without a word: the first still of
# all has that of frame 0, and is frame 14; all others show what is ahead of their positions, too, by half of the time between two: by 0.47 s and 4.7 m at 1 a
# second, by 2.3 m at 2. ffmpeg's filter `fps` gives the last frame of the interval around an instant, and srtgeotag takes it for the frame at that instant
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
python3 -m venv venv
venv/bin/pip install --quiet --disable-pip-version-check srtgeotag==0.2.0 pillow==13.0.0 imageio-ffmpeg==0.6.0 numpy==2.4.6 2>/dev/null
cat > stills.py <<'PYTHON'
import json
import subprocess
from pathlib import Path

import imageio_ffmpeg
import numpy as np
from PIL import Image
from srtgeotag.extractor import extract_video

FRAMES, HERTZ, METRES_A_FRAME, METRES_A_DEGREE = 120, 30, 1 / 3, 111_195.0
ffmpeg = imageio_ffmpeg.get_ffmpeg_exe()
print(subprocess.run([ffmpeg, "-version"], capture_output=True, text=True, check=True).stdout.split("Copyright")[0])
pictures = b"".join(np.full((64, 64), 16 + frame, np.uint8).tobytes() for frame in range(FRAMES))
raw = ["-f", "rawvideo", "-pix_fmt", "gray", "-s", "64x64", "-r", str(HERTZ), "-i", "-"]
subprocess.run([ffmpeg, "-loglevel", "error", *raw, "-c:v", "ffv1", "drone.mkv"], input=pictures, check=True)


def clock(frame):
    return f"00:00:{frame // HERTZ:02}," + f"{frame % HERTZ * 1000 // HERTZ:03}"


Path("drone.srt").write_text(
    "".join(
        f"{frame + 1}\n{clock(frame)} --> {clock(frame + 1)}\nFrameCnt: {frame + 1}, DiffTime: 33ms\n2026-06-01 12:{clock(frame)[3:].replace(',', '.')}\n"
        f"[latitude: {47 + frame * METRES_A_FRAME / METRES_A_DEGREE:.9f}] [longitude: 8.0] [rel_alt: 30.0 abs_alt: 500.0]\n\n"
        for frame in range(FRAMES)
    )
)
for per_second, expected in ((1, 14), (2, 7)):
    stills = extract_video("drone.mkv", f"at_{per_second}", fps=per_second, image_format="png", srt="drone.srt", ffmpeg=ffmpeg).frames
    ahead = []
    for still in stills[:-1]:
        with Image.open(still) as image:
            shown = round(float(np.asarray(image.convert("L")).mean())) - 16
            told = json.loads(image.getexif()[270])
        ahead.append(shown - (told["frame_count"] - 1))
    print(f"{per_second} a second: stills are {ahead} frames ahead of their positions, {ahead[0] * METRES_A_FRAME:.1f} m")
    assert set(ahead) == {expected}
PYTHON
venv/bin/python stills.py 2> said.txt || { tail -5 said.txt; exit 1; }
if grep -i warn said.txt; then exit 1; fi
