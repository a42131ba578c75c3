"""Whether anything changed: the one package that knows what to check, in which order, and when to plan in full.

A *fingerprint* is a text that changes whenever what it stands for does: code, files, recordings, records of the database,
artifacts, datasets. When a plan finds nothing to do, the fingerprints are noted in one cache file in the state folder.
If one differs later, is missing or cannot be read, `PlanNeeded` is raised, and the full plan decides. There are two
users: the command, which may have nothing to do at all (`decide`), and the planner, for each recording (`plan_cache`).
So a fingerprint that changes without cause costs time and is never wrong.

Nothing here reads or hashes content, and no module imports more than a little of the standard library: the whole
decision has to be made in the time that Dagster needs to begin importing.
"""
