"""Radar files in the layout of nuScenes, `.pcd`: a PCD 0.7 header and 18 binary fields per target.

They are made for the reader that nuScenes users have, `RadarPointCloud.from_file` of
nuscenes-devkit, which is in part stricter than the format, in part laxer:

* it asserts that every field ends *before* the end of the data, so one byte follows the last
  target (a line feed; other readers ignore it);
* it keeps only targets with `invalid_state` 0, `ambig_state` 3 and `dyn_prop` 0 to 6, so these
  are the defaults if the radar does not report states (valid, unambiguous, 4 = unknown motion);
  recorded states are written unchanged;
* it asserts that there is a target, and takes any NaN in the first one as the sign of an empty
  file. So a radar reading without targets is written as one target of NaN, which the reader
  turns into an empty cloud; no other NaN is ever written, and unknown numbers are 0.
"""

from collections.abc import Mapping
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from bagassets.base.errors import DatasetError

# Name, numpy type and default value, in the order of the file.
_LAYOUT: tuple[tuple[str, str, float], ...] = (
    ("x", "<f4", 0.0),
    ("y", "<f4", 0.0),
    ("z", "<f4", 0.0),
    ("dyn_prop", "<i1", 4.0),
    ("id", "<i2", 0.0),
    ("rcs", "<f4", 0.0),
    ("vx", "<f4", 0.0),
    ("vy", "<f4", 0.0),
    ("vx_comp", "<f4", 0.0),
    ("vy_comp", "<f4", 0.0),
    ("is_quality_valid", "<i1", 1.0),
    ("ambig_state", "<i1", 3.0),
    ("x_rms", "<i1", 0.0),
    ("y_rms", "<i1", 0.0),
    ("invalid_state", "<i1", 0.0),
    ("pdh0", "<i1", 0.0),
    ("vx_rms", "<i1", 0.0),
    ("vy_rms", "<i1", 0.0),
)
FIELDS = tuple(name for name, _, _ in _LAYOUT)
_DTYPE = np.dtype([(name, kind) for name, kind, _ in _LAYOUT])
# The single target of a file without targets.
_NOTHING = np.array(tuple(np.nan if kind == "<f4" else default for _, kind, default in _LAYOUT), _DTYPE)
_TRAILER = b"\n"


def radar_bytes(targets: Mapping[str, NDArray[np.float64]]) -> bytes:
    """Return the content of the file.

    `id` keeps 15 bits; if the radar gives none, it is the number of the target in the message.
    If the radar gives no velocities compensated for ego motion, uncompensated ones replace them.
    Other integers are rounded and limited to the range of their field.

    Args:
        targets: field -> (N,) values; x and y are required; fields not in `FIELDS` are not allowed.

    Raises:
        ValueError: x or y is missing, or a field is not in `FIELDS`.
    """
    if not {"x", "y"} <= targets.keys() <= set(FIELDS):
        raise ValueError(f"radar targets need x and y, and may have {FIELDS}, got {sorted(targets)}")
    number = len(targets["x"])
    if number == 0:
        return _header(1) + _NOTHING.tobytes() + _TRAILER
    values = dict(targets)
    values.setdefault("id", np.arange(number, dtype=np.float64))
    values["id"] = np.mod(_finite(values["id"], 0.0), 1 << 15)
    if "vx" in values and not {"vx_comp", "vy_comp"} & values.keys():
        values["vx_comp"] = values["vx"]
        values["vy_comp"] = values.get("vy", np.zeros(number))
    table = np.zeros(number, dtype=_DTYPE)
    for name, kind, default in _LAYOUT:
        column = _finite(values.get(name, np.full(number, default)), default)
        limits = np.finfo(kind) if kind == "<f4" else np.iinfo(kind)
        limited = np.clip(column, limits.min, limits.max)
        table[name] = limited if kind == "<f4" else np.rint(limited)
    return _header(number) + table.tobytes() + _TRAILER


def read_radar_file(path: Path) -> NDArray[np.void]:
    """Return the targets of a file that `radar_bytes` wrote, a structured array with `FIELDS`.

    Raises:
        DatasetError: it is not such a file.
    """
    data = path.read_bytes()
    head, found, body = data.partition(b"DATA binary\n")
    points = [line for line in head.split(b"\n") if line.startswith(b"POINTS ")]
    if not found or not points or len(body) < int(points[0].split()[1]) * _DTYPE.itemsize:
        raise DatasetError(f"{path}: is not a radar file in the nuScenes layout; build again to replace it.")
    table = np.frombuffer(body, dtype=_DTYPE, count=int(points[0].split()[1]))
    return np.asarray(table[~np.isnan(table["x"])])


def _finite(column: NDArray[np.float64], default: float) -> NDArray[np.float64]:
    return np.where(np.isfinite(column), column, default)


def _header(number: int) -> bytes:
    kinds = [np.dtype(kind) for _, kind, _ in _LAYOUT]
    lines = (
        "# .PCD v0.7 - Point Cloud Data file format",
        "VERSION 0.7",
        "FIELDS " + " ".join(FIELDS),
        "SIZE " + " ".join(str(kind.itemsize) for kind in kinds),
        "TYPE " + " ".join("F" if kind.kind == "f" else "I" for kind in kinds),
        "COUNT " + " ".join("1" for _ in kinds),
        f"WIDTH {number}",
        "HEIGHT 1",
        "VIEWPOINT 0 0 0 1 0 0 0",
        f"POINTS {number}",
        "DATA binary",
    )
    return ("\n".join(lines) + "\n").encode()
