"""Reading finished datasets, in notebooks and training: no Dagster, no devkit, nothing imported before it is needed."""
