"""Runs: what is in one, creating, executing and following it, and keeping two from the same recording."""
