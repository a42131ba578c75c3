"""Steps: pure functions from declared inputs and parameters to the files of an artifact."""
