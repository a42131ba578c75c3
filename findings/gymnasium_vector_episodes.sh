#!/usr/bin/env bash
# Demonstrations are collected in two copies of an environment at once (`gymnasium.vector`), by the usual loop: observation, action, reward, next observation, whether it
# has ended. Each episode has three steps, and its observation counts them. Which rows come of two episodes?
# Guess: three for each, the last with the observation at its end; or that one in `info`, and the first of the next episode in its place.
# Seen with gymnasium 1.4.0 on 2026-11-29, as it is set up (`AutoresetMode.NEXT_STEP`), without a word: FOUR. After the end, the next `step` resets: its action never
# reaches the environment, its reward is 0, it has not ended, and it leads from the last observation of an episode to the first of the next one, here from 3 to 0.
# A model of the robot learns that leap, and one row of four has an action that nobody carried out; nothing marks that row but the end before it.
# With `AutoresetMode.SAME_STEP` there are three, and the observation at the end is in `info["final_obs"]`; the row itself has the first of the next episode.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check gymnasium==1.4.0 numpy==2.4.6
"$folder/venv/bin/python" - <<'PYTHON'
import gymnasium
import numpy as np
from gymnasium.vector import AutoresetMode, SyncVectorEnv


class Rail(gymnasium.Env):
    """A carriage whose episodes have three steps; its observation counts them, its reward is the action."""

    observation_space = gymnasium.spaces.Box(0, 100, (1,))
    action_space = gymnasium.spaces.Box(-1, 1, (1,))

    def reset(self, seed=None, options=None):
        super().reset(seed=seed)
        self.steps = 0
        return np.zeros(1, dtype=np.float32), {}

    def step(self, action):
        self.steps += 1
        return np.array([self.steps], dtype=np.float32), float(action[0]), self.steps == 3, False, {}


def rows(**options):
    """Return observation, reward, next observation and end of each step of the first copy."""
    copies = SyncVectorEnv([Rail, Rail], **options)
    observation, _ = copies.reset()
    found = []
    for _ in range(8):
        following, reward, ended, _, info = copies.step(np.full((2, 1), 0.5, dtype=np.float32))
        found.append((int(observation[0, 0]), float(reward[0]), int(following[0, 0]), bool(ended[0]), "final_obs" in info))
        observation = following
    return found


by_default, same_step = rows(), rows(autoreset_mode=AutoresetMode.SAME_STEP)
print("observation, reward, next observation, end:", [row[:4] for row in by_default])
print("SAME_STEP:                                 ", [row[:4] for row in same_step])
assert by_default == [(0, 0.5, 1, False, False), (1, 0.5, 2, False, False), (2, 0.5, 3, True, False), (3, 0, 0, False, False)] * 2
assert same_step[:3] == [(0, 0.5, 1, False, False), (1, 0.5, 2, False, False), (2, 0.5, 0, True, True)] and same_step[3] == same_step[0]
PYTHON
