"""What is damaged in a store, all of it read at once."""

from bagassets.store.integrity import artifacts_in, check_artifact, check_records, record_folders


def check_store(store):
    """Yield what is damaged; nothing is changed."""
    made_by = {}
    for folder in record_folders(store):
        yield from check_records(store, folder, made_by)
    for artifact in artifacts_in(store):
        yield from check_artifact(artifact, made_by.get(artifact.digest))
