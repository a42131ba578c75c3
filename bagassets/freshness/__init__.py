"""Whether anything changed: the one place that knows what is looked at, in which order, and what counts as doubt.

A *mark* is a text that changes whenever something does: code, files, recordings, records of the database, artifacts,
datasets. Marks are noted, in one cache file in the state folder, when a plan finds nothing to do; whatever has another
mark later, is missing or cannot be read is a doubt, and who doubts looks closer. Two ask: the command that may have
nothing to do, about everything at once (`decide`), and the planner about each recording (`recordings`). So a mark that
changes without cause costs time, and nothing is wrong.

Nothing here reads or hashes content, and no module imports more than the standard library, little of it: the whole
decision has to be made in the time that Dagster needs to begin importing.
"""
