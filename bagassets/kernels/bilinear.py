"""Bilinear look-up of 8-bit colour images through fixed-point maps, like `cv2.remap`.

Faster than OpenCV, which waits for memory: a lens bends rows, and the processor cannot predict which part of the image is
next. Here each pixel is prefetched some time before it is needed; so are the maps, since a processor that foresees their
next line does not foresee their next page.
"""

import cv2
import numpy as np
from numpy.typing import NDArray

from bagassets.kernels.machine_code import Ir, MachineCode, begin_function, counting, everywhere

__all__ = ["BilinearLookup"]

_LANES = 16  # pixels that are computed together
_AHEAD = 8  # groups of pixels between the prefetch of a pixel and its use
_FAR_AHEAD = 64  # likewise for the maps: a page of one of them
_BITS = 5  # OpenCV's maps count 32nds of a pixel (INTER_BITS)
_MOST_AT_ONCE = 32_000  # OpenCV's maps are no wider


class BilinearLookup:
    """Looks up images of one size through one pair of maps.

    Args:
        xy: (H, W, 2) int16, source of each pixel: column and row of the upper left of four.
        fraction: (H, W) uint16, 32 * y + x, in 32nds of a pixel.
        width: width of the source images.
        height: height of the source images.
    """

    def __init__(self, xy: NDArray[np.int16], fraction: NDArray[np.uint16], width: int, height: int) -> None:
        self._xy = np.ascontiguousarray(xy)
        self._fraction = np.ascontiguousarray(fraction)
        self._size = (height, width)
        # All four pixels lie in the image.
        inside = cv2.inRange(self._xy, (0, 0, 0, 0), (width - 2, height - 2, 0, 0)).ravel() != 0
        self._some_black = False
        if inside.all() and len(inside) % _LANES == 0:
            self._runs = np.array([0, len(inside) // _LANES], dtype=np.int64)
            self._others = np.empty(0, dtype=np.int64)
            return
        # Unsigned, what is left of the image or above it is far to the right or below.
        x, y = (np.ascontiguousarray(self._xy[..., axis]).view(np.uint16).ravel() for axis in range(2))
        whole = inside[: len(inside) // _LANES * _LANES].reshape(-1, _LANES)
        groups: NDArray[np.bool_] = np.logical_and.reduce(whole, axis=1)
        edges = np.flatnonzero(np.diff(groups, prepend=False, append=False))
        self._runs = edges.astype(np.int64)  # begin, end, begin, end, …
        just_before = np.uint16(0xFFFF)  # -1: two of the four pixels are in the image
        done = ((x >= width) & (x != just_before)) | ((y >= height) & (y != just_before))
        self._some_black = bool(done.any())
        done[: len(groups) * _LANES] |= np.repeat(groups, _LANES)
        self._others = np.flatnonzero(~done)  # at the border, or between it and a whole group

    @property
    def maps(self) -> tuple[NDArray[np.int16], NDArray[np.uint16]]:
        """The maps, for `cv2.remap`."""
        return self._xy, self._fraction

    @property
    def is_fast(self) -> bool:
        """True if there is machine code for this processor; else use `cv2.remap`."""
        return _LOOKUP.function() is not None

    def __call__(self, bgra: NDArray[np.uint8]) -> NDArray[np.uint8]:
        """Return the (H, W, 3) BGR image of C-contiguous (height, width, 4) BGRA pixels.

        Raises:
            ValueError: the pixels have another shape.
            RuntimeError: there is no machine code for this processor.
        """
        function = _LOOKUP.function()
        if function is None:
            raise RuntimeError("there is no machine code for this processor")
        if bgra.dtype != np.uint8 or bgra.shape != (*self._size, 4) or not bgra.flags.c_contiguous:
            raise ValueError(f"{bgra.shape} {bgra.dtype} is not an image of {self._size}")
        looked_up = (np.zeros if self._some_black else np.empty)((self._fraction.size, 3), np.uint8)
        function(
            bgra.ctypes.data,
            bgra.strides[0],
            self._xy.ctypes.data,
            self._fraction.ctypes.data,
            looked_up.ctypes.data,
            self._runs.ctypes.data,
            len(self._runs) // 2,
        )
        for part in np.array_split(self._others, -(-len(self._others) // _MOST_AT_ONCE) or 1):
            if len(part):
                looked_up[part] = self._at(bgra, part)
        return looked_up.reshape(*self._fraction.shape, 3)

    def _at(self, bgra: NDArray[np.uint8], pixels: NDArray[np.int64]) -> NDArray[np.uint8]:
        """Return some pixels from OpenCV, which handles the border."""
        xy = self._xy.reshape(-1, 2)[pixels][None]
        fraction = self._fraction.ravel()[pixels][None]
        mixed: NDArray[np.uint8] = np.asarray(cv2.remap(bgra, xy, fraction, cv2.INTER_LINEAR), np.uint8)
        return mixed[0, :, :3]


def _lookup_function() -> Ir:
    """Return the function: source, its bytes per row, both maps, target, runs of groups, number of runs."""
    from llvmlite import ir

    i8, i16, i32, i64 = (ir.IntType(bits) for bits in (8, 16, 32, 64))
    function, b = begin_function("lookup", [i8, None, i32, i16, i8, i64, None])
    source, stride, xy, fraction, target, runs, number = function.args
    signature = ir.FunctionType(ir.VoidType(), [i8.as_pointer(), i32, i32, i32])
    prefetch = ir.Function(function.module, signature, "llvm.prefetch.p0")

    def splat(kind: Ir, value: int, lanes: int) -> Ir:
        return ir.Constant(ir.VectorType(kind, lanes), [value] * lanes)

    def lanes_of(vector: Ir, lanes: list[int]) -> Ir:
        chosen = ir.Constant(ir.VectorType(i32, len(lanes)), lanes)
        return b.shuffle_vector(vector, ir.Constant(vector.type, ir.Undefined), chosen)

    def lanes_in(vector: Ir) -> list[Ir]:
        return [b.extract_element(vector, i32(lane)) for lane in range(vector.type.count)]

    def load(pointer: Ir, index: Ir, kind: Ir, align: int) -> Ir:
        return b.load(b.bitcast(b.gep(pointer, [index]), kind.as_pointer()), align=align)

    def offsets(packed: Ir) -> Ir:
        """Return where pixels begin in the source, whose columns and rows are the halves of 32 bits."""
        lanes = packed.type.count
        half = splat(i32, 16, lanes)
        column, row = b.ashr(b.shl(packed, half), half), b.ashr(packed, half)
        strides = everywhere(b, b.trunc(stride, i32), lanes)
        return b.add(b.mul(row, strides), b.shl(column, splat(i32, 2, lanes)))

    def mixed_in_row(pixels: Ir, share: Ir) -> Ir:
        """Return 32 times the mean of two neighbours, in 16 bits: (each left and right) to (each)."""
        left = lanes_of(pixels, [8 * pixel + c for pixel in range(_LANES) for c in range(4)])
        right = lanes_of(pixels, [8 * pixel + 4 + c for pixel in range(_LANES) for c in range(4)])
        left, right = (b.zext(side, values16) for side in (left, right))
        return b.add(b.shl(left, splat(i16, _BITS, values)), b.mul(b.sub(right, left), share))

    values = 4 * _LANES
    values16, values32 = ir.VectorType(i16, values), ir.VectorType(i32, values)
    each_pixel = [pixel for pixel in range(_LANES) for _ in range(4)]
    with counting(b, i64(0), number) as run:
        begin = b.load(b.gep(runs, [b.mul(run, i64(2))]))
        end = b.load(b.gep(runs, [b.add(b.mul(run, i64(2)), i64(1))]))
        with counting(b, begin, end) as group:
            later = b.add(group, i64(_AHEAD))
            later = b.select(b.icmp_signed("<", later, end), later, group)
            [asked] = lanes_in(offsets(load(xy, b.mul(later, i64(_LANES)), ir.VectorType(i32, 1), 4)))
            below = b.gep(source, [b.add(b.zext(asked, i64), stride)])
            b.call(prefetch, [below, i32(0), i32(3), i32(1)])  # to be read, often, as data
            for maps in (xy, fraction):
                far = b.gep(maps, [b.mul(b.add(group, i64(_FAR_AHEAD)), i64(_LANES))])
                b.call(prefetch, [b.bitcast(far, i8.as_pointer()), i32(0), i32(3), i32(1)])

            first = b.mul(group, i64(_LANES))
            upper = lower = ir.Constant(ir.VectorType(i64, _LANES), ir.Undefined)
            for lane, offset in enumerate(lanes_in(offsets(load(xy, first, ir.VectorType(i32, _LANES), 4)))):
                at = b.zext(offset, i64)
                upper = b.insert_element(upper, load(source, at, i64, 1), i32(lane))
                lower = b.insert_element(lower, load(source, b.add(at, stride), i64, 1), i32(lane))
            share = load(fraction, first, ir.VectorType(i16, _LANES), 2)
            share_x = lanes_of(b.and_(share, splat(i16, 2**_BITS - 1, _LANES)), each_pixel)
            share_y = lanes_of(b.lshr(share, splat(i16, _BITS, _LANES)), each_pixel)
            pixels = ir.VectorType(i8, 2 * values)
            above, beneath = (mixed_in_row(b.bitcast(row, pixels), share_x) for row in (upper, lower))
            rest_y = b.sub(splat(i16, 2**_BITS, values), share_y)
            above, beneath, rest_y, share_y = (
                b.sext(part, values32) for part in (above, beneath, rest_y, share_y)
            )
            total = b.add(b.mul(above, rest_y), b.mul(beneath, share_y))  # 1024 times the mean
            rounded = b.lshr(
                b.add(total, splat(i32, 1 << 2 * _BITS - 1, values)), splat(i32, 2 * _BITS, values)
            )
            bgra = b.trunc(rounded, ir.VectorType(i8, values))
            bgr = lanes_of(bgra, [4 * pixel + c for pixel in range(_LANES) for c in range(3)])
            put = b.bitcast(b.gep(target, [b.mul(first, i64(3))]), bgr.type.as_pointer())
            b.store(bgr, put, align=1)
    b.ret_void()
    return function


_LOOKUP = MachineCode("lookup", _lookup_function)
