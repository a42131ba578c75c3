"""A server that has everything imported and forks a worker per job, in the way of Bazel's.

It knows nothing of Dagster: it is told which function to call before it serves (that one
imports the heavy modules), and each job names the function that a worker calls.
"""
