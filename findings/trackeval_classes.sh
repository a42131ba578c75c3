#!/usr/bin/env bash
# Tracks of cars, with labels of cars, are in the text format of the MOT benchmark, which has a number for each class: 1 for pedestrians, 3 for cars. Tracks and labels are
# the same. What do HOTA and MOTA say, by TrackEval, the benchmark's own evaluation? Guess: 1 and 1; or an error, if it evaluates pedestrians alone.
# Seen with trackeval 1.3.0 on 2026-11-29, without a word: HOTA 0, MOTA -10, by 10 false alarms and no label. Labels of any other class than pedestrians are left out, and
# the tracks, whose class the format does not have, all count as pedestrians. The same with labels whose confidence (the seventh column) is 0: they are left out, while
# tracks with a confidence of 0 count like any other. With class 1 in the labels both are 1.
# It refuses, in words, a frame 0 and frames beyond the length of the sequence.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check trackeval==1.3.0
cd "$folder"
venv/bin/python - <<'PYTHON'
import contextlib
import io
from pathlib import Path

from trackeval import Evaluator
from trackeval.datasets import MotChallenge2DBox
from trackeval.metrics import CLEAR, HOTA

FRAMES = range(1, 11)


def evaluate(name, label_end, track_end):
    """Return HOTA, MOTA, labels and false alarms of one car, labelled and tracked alike; lines end with these columns."""
    for path, end in ((f"{name}/labels/MOT17-train/drive/gt/gt.txt", label_end), (f"{name}/tracks/MOT17-train/mine/data/drive.txt", track_end)):
        Path(path).parent.mkdir(parents=True)
        Path(path).write_text("".join(f"{frame},1,{10 * frame},100,50,100,{end}\n" for frame in FRAMES))
    Path(f"{name}/labels/MOT17-train/drive/seqinfo.ini").write_text(f"[Sequence]\nname=drive\nseqLength={len(FRAMES)}\n")
    data = MotChallenge2DBox.get_default_dataset_config()
    data |= {"GT_FOLDER": f"{name}/labels", "TRACKERS_FOLDER": f"{name}/tracks", "SPLIT_TO_EVAL": "train", "SEQ_INFO": {"drive": len(FRAMES)}}
    quiet = {"PRINT_CONFIG": False, "PRINT_RESULTS": False, "PLOT_CURVES": False, "OUTPUT_SUMMARY": False, "OUTPUT_DETAILED": False}
    with contextlib.redirect_stdout(io.StringIO()):
        results, _ = Evaluator(Evaluator.get_default_eval_config() | quiet).evaluate([MotChallenge2DBox(data)], [HOTA(), CLEAR()])
    found = results["MotChallenge2DBox"]["mine"]["COMBINED_SEQ"]["pedestrian"]
    labels = found["CLEAR"]["CLR_TP"] + found["CLEAR"]["CLR_FN"]
    return round(float(found["HOTA"]["HOTA"].mean()), 3), float(found["CLEAR"]["MOTA"]), int(labels), int(found["CLEAR"]["CLR_FP"])


seen = {
    "as cars": evaluate("cars", "1,3,1", "1,-1,-1,-1"),
    "as pedestrians": evaluate("pedestrians", "1,1,1", "1,-1,-1,-1"),
    "labels of confidence 0": evaluate("labels", "0,1,1", "1,-1,-1,-1"),
    "tracks of confidence 0": evaluate("tracks", "1,1,1", "0,-1,-1,-1"),
}
for name, result in seen.items():
    print(f"{name}: HOTA {result[0]:g}, MOTA {result[1]:g}, {result[2]} labels, {result[3]} false alarms")
assert seen["as cars"] == seen["labels of confidence 0"] == (0, -10, 0, 10)
assert seen["as pedestrians"] == seen["tracks of confidence 0"] == (1, 1, 10, 0)
PYTHON
