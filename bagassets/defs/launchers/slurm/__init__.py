"""Runs executed by jobs of Slurm: a run launcher, and what it submits.

Placement, queueing, limits and accounting are Slurm's. All that is done here is to pack runs into jobs. A run moves
through the folders of a spool on a file system that all nodes share, each time by one atomic rename, so that at most
one process has it: `launcher` puts it into `waiting`, `keeper` moves it into the folder of a job, and `job`, on the
node, takes it from there when it begins it.
"""
