"""The engine: it derives the actions of a recording and runs those whose results are not in the store.

It knows the assets by name, and nothing about Dagster.
"""
