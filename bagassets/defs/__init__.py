"""The Dagster side: assets, checks, the sensor, runs and how they are launched.

Nearly empty on purpose: the launcher is imported by processes that need no assets.
"""
