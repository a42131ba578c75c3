"""The engine: which actions a recording needs, from what, and running those that are not known yet.

It knows the assets by name but nothing of Dagster.
"""
