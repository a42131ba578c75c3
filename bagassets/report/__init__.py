"""Pages for people about the whole dataset: the report and the map."""
