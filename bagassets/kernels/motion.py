"""Moving points that were measured while the sensor moved, each by the transform of its time."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from bagassets.kernels.machine_code import MachineCode, begin_function, counting, everywhere

__all__ = ["move_points"]


def move_points(
    points: NDArray[np.float32],
    since_ns: NDArray[np.int64],
    knots_ns: NDArray[np.int64],
    transforms: NDArray[np.float64],
    knot_ns: int,
) -> bool:
    """Transform points in place; return False, and do nothing, if that cannot be done here.

    Transforms are interpolated between knots entry by entry, in double precision.

    Args:
        points: (N, 5), C-contiguous, changed in their first three columns.
        since_ns: (N,) time of each point after the first knot.
        knots_ns: (M,) times of the knots, M >= 2, the first one 0.
        transforms: (M, 12) rows of 3x4 matrices at the knots.
        knot_ns: how far knots are apart, but for the last.
    """
    function = _MOVE.function()
    if (
        function is None
        or points.dtype != np.float32
        or not points.flags.c_contiguous
        or points.shape[1] != 5
    ):
        return False
    columns = np.zeros((len(knots_ns), 4, 4))  # of each matrix, with a fourth row for even vectors
    columns[:, :, :3] = transforms.reshape(-1, 3, 4).transpose(0, 2, 1)
    knots, since = (np.ascontiguousarray(times, dtype=np.int64) for times in (knots_ns, since_ns))
    function(
        points.ctypes.data,
        since.ctypes.data,
        len(points),
        knots.ctypes.data,
        columns.ctypes.data,
        len(knots) - 2,
        knot_ns,
    )
    return True


def _build() -> Any:
    """Return the function: points, their times and number, knots, matrices, last interval, its length."""
    from llvmlite import ir  # noqa: PLC0415

    i64, single, double = ir.IntType(64), ir.FloatType(), ir.DoubleType()
    four = ir.VectorType(double, 4)
    function, b = begin_function("move", [single, i64, None, i64, four, None, None])
    points, times, number, knots, columns, last, length = function.args

    def at(pointer: Any, index: Any) -> Any:
        return b.load(b.gep(pointer, [index]), align=8)

    matrix, previous = [b.alloca(four) for _ in range(4)], b.alloca(i64)
    b.store(i64(-1), previous)
    with counting(b, i64(0), number) as point:
        time = at(times, point)
        # Lasers fire in groups: points with one time follow each other, and share a matrix.
        with b.if_then(b.icmp_signed("!=", time, b.load(previous))):
            b.store(time, previous)
            knot = b.udiv(time, length)
            left = b.select(b.icmp_signed("<", knot, last), knot, last)
            right = b.add(left, i64(1))
            begin = at(knots, left)
            width = b.sub(at(knots, right), begin)
            width = b.select(b.icmp_signed("<", width, i64(1)), i64(1), width)
            share = b.fdiv(b.sitofp(b.sub(time, begin), double), b.sitofp(width, double))
            for column, kept in enumerate(matrix):
                low = at(columns, b.add(b.mul(left, i64(4)), i64(column)))
                high = at(columns, b.add(b.mul(right, i64(4)), i64(column)))
                b.store(b.fadd(low, b.fmul(b.fsub(high, low), everywhere(b, share, 4))), kept)
        first = b.gep(points, [b.mul(point, i64(5))])
        x, y, z = (
            everywhere(b, b.fpext(b.load(b.gep(first, [i64(axis)]), align=4), double), 4) for axis in range(3)
        )
        of_x, of_y, of_z, shift = (b.load(kept) for kept in matrix)
        moved = b.fadd(b.fmul(of_x, x), b.fmul(of_y, y))
        moved = b.fadd(b.fadd(moved, b.fmul(of_z, z)), shift)
        rounded = b.fptrunc(moved, ir.VectorType(single, 4))
        for axis in range(3):
            b.store(b.extract_element(rounded, ir.IntType(32)(axis)), b.gep(first, [i64(axis)]), align=4)
    b.ret_void()
    return function


_MOVE = MachineCode("move", _build)
