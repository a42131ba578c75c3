"""What Dagster knows of a project: names, partitions, databases, and how what was made is recorded and read back."""
