"""What all rooms stand on: errors, names of JSON, files that are swapped whole, locks, fingerprints, plug-ins; knows none of them."""
