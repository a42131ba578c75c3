"""How runs become processes: on the fork server of a project, or in Slurm jobs."""
