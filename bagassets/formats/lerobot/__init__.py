"""The LeRobot dataset, version 3.0: episodes on a fixed grid of times, with one video for each camera."""
