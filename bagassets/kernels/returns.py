"""Points and times out of the returns that velodyne-decoder decodes: the hot loop of lidar packets."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bagassets.kernels.machine_code import Ir, MachineCode, begin_function, counting

__all__ = ["take_returns"]

_COLUMNS = ("x", "y", "z", "intensity", "ring")
_SIZE = 32  # bytes of a return
_OFFSETS = {"x": 0, "y": 4, "z": 8, "intensity": 12, "time": 16, "ring": 22}
_FIELDS = {name: (np.dtype("u1" if name == "ring" else "<f4"), offset) for name, offset in _OFFSETS.items()}


def take_returns(
    returns: NDArray[np.void], first_ns: int, points: NDArray[np.float32], times_ns: NDArray[np.int64]
) -> None:
    """Fill in the point and the time of each return.

    Args:
        returns: (N,) with fields x, y, z (metres), intensity, ring and time (seconds after `first_ns`), as the decoder
            gives them.
        first_ns: when the first packet was sent.
        points: (N, 5) C-contiguous, becomes x, y, z, intensity, ring.
        times_ns: (N,) becomes the times.
    """
    function = _TAKE.function()
    fields: Mapping[str, Any] = returns.dtype.fields or {}
    known = returns.dtype.itemsize == _SIZE and all(fields[name][:2] == _FIELDS[name] for name in _FIELDS)
    if function is None or not known or not (returns.flags.c_contiguous and points.flags.c_contiguous):
        _twin(returns, first_ns, points, times_ns)
        return
    function(returns.ctypes.data, first_ns, points.ctypes.data, times_ns.ctypes.data, len(returns))


def _twin(
    returns: NDArray[np.void], first_ns: int, points: NDArray[np.float32], times_ns: NDArray[np.int64]
) -> None:
    """Do the same without machine code."""
    for column, name in enumerate(_COLUMNS):
        points[:, column] = returns[name]
    times_ns[:] = np.rint(returns["time"].astype(np.float64) * 1e9).astype(np.int64) + first_ns


def _take_function() -> Ir:
    """Return the function: returns, time of the first packet, points, times, number of returns."""
    from llvmlite import ir

    i8, f32, f64, i64 = ir.IntType(8), ir.FloatType(), ir.DoubleType(), ir.IntType(64)
    function, b = begin_function("take_returns", [i8, None, f32, i64, None])
    returns, first, points, times, number = function.args
    floats = b.bitcast(returns, f32.as_pointer())
    nearest = function.module.declare_intrinsic("llvm.nearbyint", [f64])
    with counting(b, i64(0), number) as each:
        begin, first_float = b.mul(each, i64(_SIZE)), b.mul(each, i64(_SIZE // 4))
        fields = {
            name: b.load(b.gep(floats, [b.add(first_float, i64(offset // 4))]))
            for name, offset in _OFFSETS.items()
            if name != "ring"
        }
        fields["ring"] = b.uitofp(b.load(b.gep(returns, [b.add(begin, i64(_OFFSETS["ring"]))])), f32)
        row = b.mul(each, i64(len(_COLUMNS)))
        for column, name in enumerate(_COLUMNS):
            b.store(fields[name], b.gep(points, [b.add(row, i64(column))]))
        since_ns = b.call(nearest, [b.fmul(b.fpext(fields["time"], f64), f64(1e9))])
        b.store(b.add(b.fptosi(since_ns, i64), first), b.gep(times, [each]))
    b.ret_void()
    return function


_TAKE = MachineCode("take_returns", _take_function)
