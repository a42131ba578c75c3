"""Measurements; `python -m benchmarks` lists them."""

import os

# Programs that are installed have their bytecode, so a checkout has to have it, too.
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)
