"""What parsed JSON is called in annotations; what is in it is for whoever reads it to check."""

from collections.abc import Mapping
from typing import Any

Json = Any
"""Any JSON value. Typed in full, every step down into it would need a cast."""

JsonObject = dict[str, Any]
"""A JSON object, or a mapping of YAML."""

JsonMapping = Mapping[str, Any]
"""A JSON object that is only read."""
