"""The vision dataset: image sequences with relative trajectories, in a plain folder layout."""
