"""Bilinear look-up of 8-bit colour images through fixed-point maps, like `cv2.remap`.

Faster than OpenCV, which waits for memory: a lens bends rows, and the processor cannot predict which part of the image is
next. Here each pixel is prefetched some time before it is needed; so are the maps, since a processor that foresees their
next line does not foresee their next page. What is left is computation. Scalar units compute where pixels lie, because
vector units have enough to do: for each pixel they gather eight bytes of the row above and eight of the row below, each two
neighbours with four channels, and mix them in place.
"""

import sys

import cv2
import numpy as np
from numpy.typing import NDArray

from bagassets.geometry.kernels.machine_code import Ir, MachineCode, begin_function, counting

_LANES = 8  # pixels that are computed together
_AHEAD = 48  # groups of pixels between the prefetch of a pixel and its use
_FAR_AHEAD = 128  # likewise for the maps: a page of one of them
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
    """Return the function: source, its bytes per row, both maps, target, runs of groups, number of runs.

    With neighbours a, b above and c, d below, and x, y in 32nds, each channel of a pixel is

        ((a (32 - y) + c y) (32 - x) + (b (32 - y) + d y) x + 512) / 1024

    rounded down, as in OpenCV. Channels 0 and 2 are computed together, and so are 1 and 3, in 16 bits each.
    """
    if sys.byteorder != "little":
        raise NotImplementedError("it takes the lowest byte of a number for the first")  # OpenCV does it then
    from llvmlite import ir

    i8, i16, i32, i64 = (ir.IntType(bits) for bits in (8, 16, 32, 64))
    function, b = begin_function("lookup", [i8, None, i32, i16, i8, i64, None])
    source, stride, xy, fraction, target, runs, number = function.args
    signature = ir.FunctionType(ir.VoidType(), [i8.as_pointer(), i32, i32, i32])
    llvm_prefetch = ir.Function(function.module, signature, "llvm.prefetch.p0")
    row_bytes = b.trunc(stride, i32)
    two_each = [pixel for pixel in range(_LANES) for _ in range(2)]
    four_each = [pixel for pixel in range(_LANES) for _ in range(4)]

    def splat(value: int, like: Ir) -> Ir:
        return ir.Constant(like.type, [value] * like.type.count)

    def lanes_of(vector: Ir, lanes: list[int]) -> Ir:
        chosen = ir.Constant(ir.VectorType(i32, len(lanes)), lanes)
        return b.shuffle_vector(vector, ir.Constant(vector.type, ir.Undefined), chosen)

    def in_lanes_of(vector: Ir, bits: int) -> Ir:
        lanes = vector.type.count * vector.type.element.width // bits
        return b.bitcast(vector, ir.VectorType(ir.IntType(bits), lanes))

    def load(pointer: Ir, index: Ir, kind: Ir, align: int) -> Ir:
        return b.load(b.bitcast(b.gep(pointer, [index]), kind.as_pointer()), align=align)

    def prefetch(pointer: Ir, index: Ir) -> None:
        place = b.bitcast(b.gep(pointer, [index]), i8.as_pointer())
        b.call(llvm_prefetch, [place, i32(0), i32(3), i32(1)])  # to be read, often, as data

    def offset(pixel: Ir) -> Ir:
        """Return where in the source the upper left neighbour of a pixel begins."""
        packed = load(xy, pixel, i32, 4)
        column, row = b.ashr(b.shl(packed, i32(16)), i32(16)), b.ashr(packed, i32(16))
        return b.zext(b.add(b.mul(row, row_bytes), b.shl(column, i32(2))), i64)

    def mixed(above: Ir, below: Ir, rests: tuple[Ir, Ir], shares: tuple[Ir, Ir]) -> Ir:
        """Return two channels of each pixel, of those of its left and right neighbours."""
        (rest_x, rest_y), (share_x, share_y) = rests, shares
        # Both of the left one, both of the right one.
        columns = b.add(b.mul(above, rest_y), b.mul(below, share_y))
        beside = lanes_of(columns, [4 * pixel + lane for pixel in range(_LANES) for lane in (0, 2, 1, 3)])
        pairs = in_lanes_of(beside, 32)
        # They are less than 2^13, but the compiler has to be told, to multiply in 16 bits.
        left, right = (
            b.and_(side, splat(0x1FFF, pairs)) for side in (pairs, b.lshr(pairs, splat(16, pairs)))
        )
        total = b.add(b.mul(left, rest_x), b.mul(right, share_x))
        half = splat(1 << 2 * _BITS - 1, total)
        return b.lshr(b.add(total, half), splat(2 * _BITS, total))

    with counting(b, i64(0), number) as run:
        begin = b.load(b.gep(runs, [b.mul(run, i64(2))]))
        end = b.load(b.gep(runs, [b.add(b.mul(run, i64(2)), i64(1))]))
        with counting(b, begin, end) as group:
            later = b.add(group, i64(_AHEAD))
            later = b.select(b.icmp_signed("<", later, end), later, group)
            prefetch(source, b.add(offset(b.mul(later, i64(_LANES))), stride))
            for maps in (xy, fraction):
                prefetch(maps, b.mul(b.add(group, i64(_FAR_AHEAD)), i64(_LANES)))

            first = b.mul(group, i64(_LANES))
            upper = lower = ir.Constant(ir.VectorType(i64, _LANES), ir.Undefined)
            for lane in range(_LANES):
                at = offset(b.add(first, i64(lane)))
                upper = b.insert_element(upper, load(source, at, i64, 1), i32(lane))
                lower = b.insert_element(lower, load(source, b.add(at, stride), i64, 1), i32(lane))
            above, below = in_lanes_of(upper, 16), in_lanes_of(lower, 16)

            parts = load(fraction, first, ir.VectorType(i16, _LANES), 2)
            share_x = b.zext(b.and_(parts, splat(2**_BITS - 1, parts)), ir.VectorType(i32, _LANES))
            share_x = lanes_of(share_x, two_each)
            rest_x = b.and_(b.sub(splat(2**_BITS, share_x), share_x), splat(2 ** (_BITS + 1) - 1, share_x))
            share_y = lanes_of(b.lshr(parts, splat(_BITS, parts)), four_each)
            rest_y = b.sub(splat(2**_BITS, share_y), share_y)
            rests, shares = (rest_x, rest_y), (share_x, share_y)

            low, eight = splat(0xFF, above), splat(8, above)
            even = mixed(b.and_(above, low), b.and_(below, low), rests, shares)
            odd = mixed(b.lshr(above, eight), b.lshr(below, eight), rests, shares)
            bgra = in_lanes_of(b.or_(even, b.shl(odd, splat(16, odd))), 8)  # in 16 bits each
            bgr = lanes_of(bgra, [8 * pixel + 2 * c for pixel in range(_LANES) for c in range(3)])
            put = b.bitcast(b.gep(target, [b.mul(first, i64(3))]), bgr.type.as_pointer())
            b.store(bgr, put, align=1)
    b.ret_void()
    return function


_LOOKUP = MachineCode("lookup", _lookup_function)
