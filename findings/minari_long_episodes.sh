#!/usr/bin/env bash
# An arm is driven at 500 Hz; its three episodes, of 80 s, 2 s and 2 s, become a Minari dataset. What comes back, by each format that it stores?
# Guess: the three, by each of them; at most they differ in size.
# Seen with minari 0.5.4 and pyarrow 26.0.1 on 2026-11-29, without a word:
#   hdf5             the three
#   arrow, parquet   three episodes of one, as soon as one is longer than 32,767 steps: the first ends after 65.5 s; what follows of it is
#                    the second, under the second's number; and the third is the second
# An episode is the batch of that number which pyarrow reads, and pyarrow cuts long files into more than one. At the cut a step is lost, as
# each batch is thought to end with an observation that has no action. The last episode is then in no way to be had, and what says how many
# steps there are goes on counting all: `total_steps` of the dataset, and of each episode.
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

LENGTHS = 40_000, 1_000, 1_000
SPACE = gymnasium.spaces.Box(-np.inf, np.inf, (1,), np.float64)


def episode(number, steps):
    """Return an episode whose observations count from a million times its number; there is one more of them than of actions."""
    count = 1e6 * number + np.arange(steps + 1.0)[:, None]
    ends = np.arange(steps) == steps - 1
    return EpisodeBuffer(observations=count, actions=count[:-1], rewards=np.zeros(steps), terminations=ends, truncations=~ends & False)


seen = {}
for form in ("hdf5", "arrow", "parquet"):
    episodes = [episode(number, steps) for number, steps in enumerate(LENGTHS)]
    minari.create_dataset_from_buffers(
        f"arm{form}-v0", episodes, observation_space=SPACE, action_space=SPACE, data_format=form,
        algorithm_name="none", author="none", author_email="none", code_permalink="none",
    )  # fmt: skip
    dataset = minari.load_dataset(f"arm{form}-v0")
    read = list(dataset.iterate_episodes())
    seen[form] = [(int(one.id), len(one.actions), float(one.observations[0, 0]), float(one.observations[-1, 0])) for one in read]
    steps = [metadata["total_steps"] for metadata in dataset.storage.get_episode_metadata(range(3))]
    print(f"{form}: (number, actions, first, last) {seen[form]}; said to be {dataset.total_steps} steps, {[int(n) for n in steps]}")
    assert dataset.total_steps == sum(LENGTHS) and [int(one) for one in steps] == list(LENGTHS)
assert seen["hdf5"] == [(n, steps, 1e6 * n, 1e6 * n + steps) for n, steps in enumerate(LENGTHS)]
assert seen["arrow"] == seen["parquet"] == [(0, 32767, 0, 32767), (1, 7232, 32768, 40000), (2, 1000, 1e6, 1e6 + 1000)]
PYTHON
