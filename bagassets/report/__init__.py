"""Pages about the whole dataset: the report and the map."""
