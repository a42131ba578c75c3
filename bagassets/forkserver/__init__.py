"""A server that has everything imported and forks a worker per job, like Bazel's.

It knows nothing about Dagster: its spec names a function to call before it serves (which
imports the heavy modules), and each job names the function that a worker calls.
"""
