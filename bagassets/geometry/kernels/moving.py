"""Moving points, each by the transform of its time: the hot loop of deskewing."""

import numpy as np
from numpy.typing import NDArray

from bagassets.geometry.kernels.machine_code import Ir, MachineCode, begin_function, counting

KNOT_NS = 1_000_000
"""Time from one knot to the next."""
_ENTRIES = 12  # of a 3x4 matrix
_CHUNK = 16_384  # points at a time without machine code, so that intermediate results stay in the processor's cache


def move_points(
    points: NDArray[np.float32],
    times_ns: NDArray[np.int64],
    knots_ns: NDArray[np.int64],
    transforms: NDArray[np.float64],
) -> None:
    """Transform points in place, each by the transform of its time, interpolated between knots entry by entry.

    Args:
        points: (N, C) C-contiguous, metres; the first three columns are changed.
        times_ns: (N,) time of each point, from the first knot to the last.
        knots_ns: (M,) at least two times, `KNOT_NS` apart; the last one may come earlier.
        transforms: (M, 12) rows of 3x4 matrices at the knots.
    """
    function = _MOVE.function()
    if function is None or not points.flags.c_contiguous:
        for begin in range(0, len(points), _CHUNK):
            part = slice(begin, begin + _CHUNK)
            _twin(points[part], times_ns[part], knots_ns, transforms)
        return
    times_ns, knots_ns = np.ascontiguousarray(times_ns), np.ascontiguousarray(knots_ns)
    transforms = np.ascontiguousarray(transforms)
    function(
        points.ctypes.data,
        points.shape[1],
        times_ns.ctypes.data,
        knots_ns.ctypes.data,
        transforms.ctypes.data,
        len(knots_ns),
        len(points),
    )


def _twin(
    points: NDArray[np.float32],
    times_ns: NDArray[np.int64],
    knots_ns: NDArray[np.int64],
    transforms: NDArray[np.float64],
) -> None:
    """Do the same without machine code."""
    # Lasers fire in groups: points with one time follow each other, and share a transform.
    begins = np.flatnonzero(np.diff(times_ns, prepend=times_ns[0] - 1))
    group_times_ns = times_ns[begins]
    left = np.minimum((group_times_ns - knots_ns[0]) // KNOT_NS, len(knots_ns) - 2)
    widths = np.maximum(np.diff(knots_ns), 1)
    share = (group_times_ns - knots_ns[left]) / widths[left]
    # Entries by rows and points by columns, so that operands are contiguous in memory.
    entries = transforms.T[:, left] + np.diff(transforms, axis=0).T[:, left] * share
    if len(begins) < len(points):
        entries = np.repeat(entries, np.diff(begins, append=len(points)), axis=1)
    x, y, z = (points[:, axis].astype(np.float64) for axis in range(3))
    for axis in range(3):
        a, b, c, d = entries[4 * axis : 4 * axis + 4]
        points[:, axis] = a * x + b * y + c * z + d


def _move_function() -> Ir:
    """Return the function: points, their columns, times, knots, matrices, number of knots and of points."""
    from llvmlite import ir

    f32, f64, i64 = ir.FloatType(), ir.DoubleType(), ir.IntType(64)
    function, b = begin_function("move_points", [f32, None, i64, i64, f64, None, None])
    points, columns, times, knots, transforms, knot_number, number = function.args
    matrix = [b.alloca(f64) for _ in range(_ENTRIES)]
    known = b.alloca(i64)
    first = b.load(knots)
    b.store(b.sub(first, i64(1)), known)  # no point has this time
    with counting(b, i64(0), number) as point:
        time = b.load(b.gep(times, [point]))
        # Lasers fire in groups, which share a transform.
        with b.if_then(b.icmp_signed("!=", time, b.load(known))):
            b.store(time, known)
            left = b.udiv(b.sub(time, first), i64(KNOT_NS))
            most = b.sub(knot_number, i64(2))
            left = b.select(b.icmp_signed("<", left, most), left, most)
            before, after = (b.load(b.gep(knots, [b.add(left, i64(more))])) for more in (0, 1))
            width = b.sub(after, before)
            width = b.select(b.icmp_signed(">", width, i64(1)), width, i64(1))
            share = b.fdiv(b.sitofp(b.sub(time, before), f64), b.sitofp(width, f64))
            at = b.mul(left, i64(_ENTRIES))
            for entry, place in enumerate(matrix):
                here, there = (
                    b.load(b.gep(transforms, [b.add(at, i64(more))])) for more in (entry, _ENTRIES + entry)
                )
                b.store(b.fadd(here, b.fmul(b.fsub(there, here), share)), place)
        begin = b.mul(point, columns)
        places = [b.gep(points, [b.add(begin, i64(axis))]) for axis in range(3)]
        x, y, z = (b.fpext(b.load(place), f64) for place in places)
        for axis, place in enumerate(places):
            p, q, r, s = (b.load(entry) for entry in matrix[4 * axis : 4 * axis + 4])
            total = b.fadd(b.fadd(b.fmul(p, x), b.fmul(q, y)), b.fmul(r, z))
            b.store(b.fptrunc(b.fadd(total, s), f32), place)
    b.ret_void()
    return function


_MOVE = MachineCode("move_points", _move_function)
