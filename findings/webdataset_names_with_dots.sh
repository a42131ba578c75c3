#!/usr/bin/env bash
# Images of a dataset are packed with tar for WebDataset; their names begin with that of the recording, drive_1.bag__CAM_FRONT__100.jpg.
# How many samples are there? Guess: one for each image, as the key is the name without its suffix.
# Seen with webdataset 1.0.2 on 2026-11-28: one for each recording. A key ends at the FIRST dot of the file name, here "drive_1", and
# what follows is the name of the field, in small letters: three images of three moments are one sample with three odd fields, without
# a word. WebDataset's own TarWriter takes such a key, too, and what is read has another: "drive.2/1.5" becomes "drive.2/1".
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check webdataset==1.0.2 numpy==2.4.6
cd "$folder"
venv/bin/python - <<'PYTHON'
import io
import tarfile

import webdataset

with tarfile.open("images.tar", "w") as archive:
    for stamp in (100, 200, 300):
        member = tarfile.TarInfo(f"drive_1.bag__CAM_FRONT__{stamp}.jpg")
        member.size = 3
        archive.addfile(member, io.BytesIO(b"jpg"))
with webdataset.TarWriter("written.tar") as writer:
    writer.write({"__key__": "drive.2/1.5", "txt": "turn left"})


def samples(path):
    found = []
    for sample in webdataset.WebDataset(path, shardshuffle=False):
        found.append((sample["__key__"], sorted(name for name in sample if not name.startswith("__"))))
    return found


seen = samples("images.tar"), samples("written.tar")
print(*seen, sep="\n")
expected = (
    [("drive_1", [f"bag__cam_front__{stamp}.jpg" for stamp in (100, 200, 300)])],
    [("drive.2/1", ["5.txt"])],
)
raise SystemExit(0 if seen == expected else "no longer so")
PYTHON
