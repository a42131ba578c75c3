"""Deciding that there is nothing to do, without importing Dagster, click, YAML or pydantic.

A build that found everything up to date leaves a snapshot of all that this was decided from. The next
one compares; whatever differs, is missing or cannot be read is a doubt, and any doubt takes the full
path, which decides anew. So the fast path can be slow, but not wrong.
"""
