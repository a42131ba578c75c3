#!/usr/bin/env bash
# A step has a label image, uint8 with classes 0 to 7, and a camera image that was recorded as it is. Both go into a Minari dataset, by each
# format that it stores. What comes back? Guess: what went in, as a dataset for learning offline is stored like any array.
# Seen with minari 0.5.4 on 2026-11-29, as it is set up (`jpeg_encoding=True`), in hdf5, arrow and parquet, without a word:
# - all that has the space Box(0, 255, uint8) and is 32 pixels or more each way is a JPEG of Pillow's quality 75. Of the label image more
#   than half of all pixels have another class, and three classes (8, 9, 10) that nothing had
# - the bound decides: the same labels in Box(0, 7) are kept to the bit, and so is an image of 31 rows. Dtype and shape tell nothing
# `create_dataset_from_buffers(…, jpeg_encoding=False)` keeps all; of a dataset that is made, nothing brings the labels back.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check \
  minari==0.5.4 gymnasium==1.4.0 pyarrow==26.0.1 h5py==3.16.0 pillow==13.0.0 numpy==2.4.6
MINARI_DATASETS_PATH=$folder/datasets "$folder/venv/bin/python" -W ignore - <<'PYTHON'
import gymnasium
import minari
import numpy as np
from minari.data_collector import EpisodeBuffer

LABELS = np.kron(np.random.default_rng(0).integers(0, 8, (3, 16, 16)), np.ones((4, 4), int)).astype(np.uint8)
IMAGES = {"bound of 255": LABELS, "bound of 7": LABELS, "31 rows": LABELS[:, :31]}
SPACES = {name: gymnasium.spaces.Box(0, 7 if name == "bound of 7" else 255, of.shape[1:], np.uint8) for name, of in IMAGES.items()}
NUMBER = gymnasium.spaces.Box(-1, 1, (1,), np.float32)


def changed(form, **options):
    """Return the share of labels that changed on the way into a dataset of this format and back, and the classes, by image."""
    name = f"labels{form}{len(options)}-v0"
    steps = EpisodeBuffer(
        observations=IMAGES, actions=np.zeros((2, 1), np.float32), rewards=np.zeros(2), terminations=np.zeros(2, bool),
        truncations=np.zeros(2, bool),
    )  # fmt: skip
    minari.create_dataset_from_buffers(
        name, [steps], observation_space=gymnasium.spaces.Dict(SPACES), action_space=NUMBER, data_format=form,
        algorithm_name="none", author="none", author_email="none", code_permalink="none", **options,
    )  # fmt: skip
    (read,) = minari.load_dataset(name).iterate_episodes()
    assert all(read.observations[image].dtype == np.uint8 for image in IMAGES)
    return {
        image: (round(float((read.observations[image] != of).mean()), 2), np.unique(read.observations[image]).tolist())
        for image, of in IMAGES.items()
    }


KEPT = 0.0, list(range(8))
for form in ("hdf5", "arrow", "parquet"):
    seen, raw = changed(form), changed(form, jpeg_encoding=False)
    print(f"{form}: (share changed, classes) {seen}")
    share, classes = seen["bound of 255"]
    assert share > 0.5 and max(classes) > 7
    assert seen["bound of 7"] == seen["31 rows"] == KEPT
    assert raw["bound of 255"] == KEPT
PYTHON
