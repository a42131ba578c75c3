"""Moving points, each by the transform of its time: the hot loop of deskewing."""

import numpy as np
from numpy.typing import NDArray

from bagassets.kernels.machine_code import Ir, MachineCode, begin_function, counting

__all__ = ["move_points"]

_ENTRIES = 12  # of a 3x4 matrix


def move_points(
    points: NDArray[np.float32],
    begins: NDArray[np.int64],
    left: NDArray[np.int64],
    fraction: NDArray[np.float64],
    transforms: NDArray[np.float64],
) -> None:
    """Transform points in place, in groups that share a transform, which is interpolated entry by entry.

    Args:
        points: (N, C) C-contiguous, metres; the first three columns are changed.
        begins: (G,) increasing, first point of each group; the first one 0.
        left: (G,) knot before the time of each group, at most M - 2.
        fraction: (G,) where between this knot and the next one that time is, 0 to 1.
        transforms: (M, 12) rows of 3x4 matrices at the knots.
    """
    function = _MOVE.function()
    if function is None or not points.flags.c_contiguous:
        _twin(points, begins, left, fraction, transforms)
        return
    edges, transforms = np.append(begins, np.int64(len(points))), np.ascontiguousarray(transforms)
    function(
        points.ctypes.data,
        points.shape[1],
        edges.ctypes.data,
        left.ctypes.data,
        fraction.ctypes.data,
        transforms.ctypes.data,
        len(begins),
    )


def _twin(
    points: NDArray[np.float32],
    begins: NDArray[np.int64],
    left: NDArray[np.int64],
    fraction: NDArray[np.float64],
    transforms: NDArray[np.float64],
) -> None:
    """Do the same without machine code."""
    # Entries by rows and points by columns, so that operands are contiguous in memory.
    entries = transforms.T[:, left] + np.diff(transforms, axis=0).T[:, left] * fraction
    if len(begins) < len(points):
        entries = np.repeat(entries, np.diff(begins, append=len(points)), axis=1)
    x, y, z = (points[:, axis].astype(np.float64) for axis in range(3))
    for axis in range(3):
        a, b, c, d = entries[4 * axis : 4 * axis + 4]
        points[:, axis] = a * x + b * y + c * z + d


def _move_function() -> Ir:
    """Return the function: points, their columns, begins and end, knots, fractions, matrices, number of groups."""
    from llvmlite import ir

    f32, f64, i64 = ir.FloatType(), ir.DoubleType(), ir.IntType(64)
    function, b = begin_function("move_points", [f32, None, i64, i64, f64, f64, None])
    points, columns, edges, left, fraction, transforms, number = function.args
    with counting(b, i64(0), number) as group:
        at = b.mul(b.load(b.gep(left, [group])), i64(_ENTRIES))
        share = b.load(b.gep(fraction, [group]))
        entries = []
        for entry in range(_ENTRIES):
            here, after = (
                b.load(b.gep(transforms, [b.add(at, i64(more))])) for more in (entry, _ENTRIES + entry)
            )
            entries.append(b.fadd(here, b.fmul(b.fsub(after, here), share)))
        begin, end = (b.load(b.gep(edges, [b.add(group, i64(more))])) for more in (0, 1))
        with counting(b, begin, end) as point:
            first = b.mul(point, columns)
            places = [b.gep(points, [b.add(first, i64(axis))]) for axis in range(3)]
            x, y, z = (b.fpext(b.load(place), f64) for place in places)
            for axis, place in enumerate(places):
                p, q, r, s = entries[4 * axis : 4 * axis + 4]
                total = b.fadd(b.fadd(b.fmul(p, x), b.fmul(q, y)), b.fmul(r, z))
                b.store(b.fptrunc(b.fadd(total, s), f32), place)
    b.ret_void()
    return function


_MOVE = MachineCode("move_points", _move_function)
