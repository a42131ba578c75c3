"""bagassets: robot recordings in, machine-learning datasets out, built like a program.

The library below this package imports no Dagster; `bagassets.defs` and
`bagassets.definitions` put it on a Dagster asset graph.
"""

__version__ = "0.1.0"
