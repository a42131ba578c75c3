"""Columns of Arrow tables, from their buffers and back.

`pa.array` and `to_numpy` import pandas where it is installed, and so does `to_pandas_dtype` in pyarrow 17: it takes a
fifth of a second and 30 MB.
"""

from collections.abc import Mapping, Sequence
from itertools import chain
from typing import Any

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

# Types that numpy calls otherwise than Arrow.
_NAMES = {"halffloat": "float16", "float": "float32", "double": "float64"}


def column(values: Sequence[Any] | NDArray[Any], kind: pa.DataType) -> pa.Array:
    """Return a column without nulls.

    Args:
        values: (N,) numbers; or a sequence of strings, of bytes, or of sequences of such.
        kind: type of the column.
    """
    if pa.types.is_primitive(kind):
        numbers = np.ascontiguousarray(values, dtype=_dtype(kind))
        return pa.Array.from_buffers(kind, len(numbers), [None, pa.py_buffer(numbers)])
    if pa.types.is_list(kind):
        inner = column([*chain.from_iterable(values)], kind.value_type)
        return pa.Array.from_buffers(kind, len(values), [None, _ends(values)], children=[inner])
    pieces = [one.encode() if isinstance(one, str) else one for one in values]
    return pa.Array.from_buffers(kind, len(pieces), [None, _ends(pieces), pa.py_buffer(b"".join(pieces))])


def table_of_rows(rows: Sequence[Mapping[str, Any]], schema: pa.Schema) -> pa.Table:
    """Return a table of rows that have a value in each column."""
    columns = [column([row[field.name] for row in rows], field.type) for field in schema]
    return pa.Table.from_arrays(columns, schema=schema)


def numbers(values: pa.ChunkedArray) -> NDArray[Any]:
    """Return a column of numbers without nulls as (N,)."""
    kind = _dtype(values.type)
    parts = [
        np.frombuffer(chunk.buffers()[1], kind, len(chunk), chunk.offset * kind.itemsize)
        for chunk in values.chunks
        if len(chunk)
    ]
    return parts[0] if len(parts) == 1 else np.concatenate([np.zeros(0, kind), *parts])


def _ends(pieces: Sequence[Any] | NDArray[Any]) -> pa.Buffer:
    """Return where each piece ends, after a zero."""
    return pa.py_buffer(np.cumsum([0, *map(len, pieces)], dtype=np.int32))


def _dtype(kind: pa.DataType) -> np.dtype[Any]:
    return np.dtype(_NAMES.get(str(kind), str(kind)))
