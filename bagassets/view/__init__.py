"""A scene of a finished dataset as an MCAP file with Foxglove's message types, for Foxglove or Rerun."""
