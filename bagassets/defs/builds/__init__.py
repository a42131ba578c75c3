"""A build from the command line: which runs are needed, ours and those of users' own assets, and in which order."""
