"""Points out of the returns in Velodyne packets: the hot loop of lidars that are recorded packet by packet.

The arithmetic is that of velodyne-decoder's C++, operation by operation in single precision, so both give the same bits,
and that library is the twin for where there is no machine code. Python hands it packets as lists of numbers, which
takes longer than all that is done with them.
"""

import ctypes
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bagassets.geometry.kernels.machine_code import Ir, MachineCode, begin_function, counting

_BLOCK = np.dtype(
    [("flag", "<u2"), ("azimuth", "<u2"), ("returns", [("distance", "<u2"), ("intensity", "u1")], 32)]
)
PACKET = np.dtype([("blocks", _BLOCK, 12), ("us", "<u4"), ("mode", "u1"), ("product", "u1")])
"""A packet (VLP-16 User Manual 63-9243 Rev. E, section 9.3)."""
BANK_FLAGS = (0xEEFF, 0xDDFF, 0xCCFF, 0xBBFF)
"""Flag of a block with the returns of lasers 0 to 31, 32 to 63, …"""
DUAL = 0x39
"""Mode of a packet with two returns for each firing, in neighbouring blocks."""

_BLOCKS = 12
LASERS = 32
"""Returns of a block."""
RETURNS = _BLOCKS * LASERS
"""Returns of a packet."""
ALL_AZIMUTHS = 36_000
"""Azimuths in packets are hundredths of a degree."""
_COLUMNS = 5  # of a point
_RETURN = _BLOCK["returns"].base.itemsize

Floats = NDArray[np.float32]


@dataclass(frozen=True, eq=False)
class Lasers:
    """The lasers of a model.

    Attributes:
        traits: (B, 32, 6) of the laser of each return, bank by bank: cosine and sine of its azimuth in the head, cosine and
            sine of its elevation, its height in metres, its ring.
        times_s: (12, 32) when each return of a packet is fired, after the packet's time.
        turning_s: (12, 32) how long the head has turned by then since the block's azimuth was taken.
        unit_m: unit of distances.
        blocks_if_dual: number of blocks in use when a packet has two returns for each firing.
        most_azimuth: blocks beyond are skipped.
    """

    traits: Floats
    times_s: Floats
    turning_s: Floats
    unit_m: Floats
    blocks_if_dual: int
    most_azimuth: int


@dataclass(frozen=True, eq=False)
class Angles:
    """Cosines and sines by the C library, of which two may differ in the last bit.

    Attributes:
        cosines: (N,)
        sines: (N,)
    """

    cosines: Floats
    sines: Floats

    @classmethod
    def of(cls, angles: Floats) -> "Angles | None":
        """Return those of (N,) angles in radians; None if there is no machine code for lidars here."""
        function, library = _EACH.function(), ctypes.CDLL(None)
        if function is None or _TAKE.function() is None or not hasattr(library, "sinf"):
            return None
        angles = np.ascontiguousarray(angles, dtype=np.float32)
        made = []
        for called in (library.cosf, library.sinf):
            values = np.empty_like(angles)
            address = ctypes.cast(called, ctypes.c_void_p).value
            function(angles.ctypes.data, values.ctypes.data, address, angles.size)
            made.append(values)
        return cls(*made)


def take_returns(
    packets: NDArray[np.void],
    since_s: Floats,
    firsts_ns: NDArray[np.int64],
    turn_rates: Floats,
    lasers: Lasers,
    turn: Angles,
    points: Floats,
    times_ns: NDArray[np.int64],
) -> int:
    """Fill in the points and times of all returns that measured something; return their number.

    Args:
        packets: (M,) `PACKET`, C-contiguous.
        since_s: (M,) time of each packet after `firsts_ns`.
        firsts_ns: (M,).
        turn_rates: (M,) how fast the head turns, hundredths of a degree a second.
        lasers: of the model.
        turn: (36000,) of all azimuths.
        points: (N, 5) C-contiguous, becomes x, y, z, intensity, ring; N is `RETURNS` for each packet, or more.
        times_ns: (N,) becomes the times.
    """
    function = _TAKE.function()
    if function is None:
        raise RuntimeError("there is no machine code for lidars here, as `Angles.of` says")
    number = np.zeros(1, dtype=np.int64)
    arrays = (
        packets, since_s, firsts_ns, turn_rates, lasers.traits, lasers.times_s, lasers.turning_s, lasers.unit_m,
        turn.cosines, turn.sines, points, times_ns, number,
    )  # fmt: skip
    addresses = [array.ctypes.data for array in arrays]
    function(*addresses, len(lasers.traits), lasers.blocks_if_dual, lasers.most_azimuth, len(packets))
    return int(number[0])


def _place(kind: np.dtype[np.void], name: str) -> int:
    """Return where a field begins, in bytes."""
    fields: Mapping[str, Any] = kind.fields or {}
    return int(fields[name][1])


def _each_function() -> Ir:
    """Return the function: numbers, results, address of a C function, number of numbers."""
    from llvmlite import ir

    f32, i64 = ir.FloatType(), ir.IntType(64)
    function, b = begin_function("each", [f32, f32, None, None])
    values, results, address, number = function.args
    called = b.inttoptr(address, ir.FunctionType(f32, [f32]).as_pointer())
    with counting(b, i64(0), number) as each:
        b.store(b.call(called, [b.load(b.gep(values, [each]))]), b.gep(results, [each]))
    b.ret_void()
    return function


def _take_function() -> Ir:
    """Return the function: the arrays of `take_returns` in order, numbers of banks and of blocks in dual mode, last azimuth, number of packets."""
    from llvmlite import ir

    i1, i8, i16, i32, i64 = (ir.IntType(bits) for bits in (1, 8, 16, 32, 64))
    f32, f64 = ir.FloatType(), ir.DoubleType()
    pointed = [i8, f32, i64, f32, f32, f32, f32, f32, f32, f32, f32, i64, i64, None, None, None, None]
    function, b = begin_function("take_returns", pointed)
    (packets, since_s, firsts, rates, traits, times_s, turning_s, unit_m, cosines, sines, points, times) = (
        function.args[:12]
    )
    found, banks, blocks_if_dual, most_azimuth, number = function.args[12:]
    halfway = function.module.declare_intrinsic("llvm.round", [f32])  # away from zero, as C's lround
    nearest = function.module.declare_intrinsic("llvm.nearbyint", [f64])
    readable, taken = b.alloca(i1), b.alloca(i64)
    b.store(i64(0), taken)
    unit = b.load(unit_m)

    def word(at: Ir) -> Ir:
        """Read two bytes, which need not be aligned."""
        loaded = b.load(b.bitcast(b.gep(packets, [at]), i16.as_pointer()), align=1)
        return b.zext(loaded, i64)

    def number_at(array: Ir, at: Ir) -> Ir:
        return b.load(b.gep(array, [at]))

    def put(at: Ir, distance: Ir, counts: Ir, laser: list[Ir], time: Ir) -> None:
        """Write the point of the return at a place; the next one takes its row if it does not count."""
        cos_azimuth, sin_azimuth, cos_elevation, sin_elevation, height, ring = laser
        measured = b.fmul(b.uitofp(b.trunc(distance, i32), f32), unit)
        level = b.fmul(measured, cos_elevation)
        x, y = b.fmul(level, cos_azimuth), b.fmul(b.fneg(level), sin_azimuth)
        z = b.fadd(b.fmul(measured, sin_elevation), height)
        intensity = b.uitofp(b.load(b.gep(packets, [b.add(at, i64(_RETURN - 1))])), f32)
        row = b.load(taken)
        for column, value in enumerate((x, y, z, intensity, ring)):
            b.store(value, b.gep(points, [b.add(b.mul(row, i64(_COLUMNS)), i64(column))]))
        b.store(time, b.gep(times, [row]))
        b.store(b.add(row, b.zext(counts, i64)), taken)

    with counting(b, i64(0), number) as packet:
        begin = b.mul(packet, i64(PACKET.itemsize))
        dual = b.icmp_unsigned(
            "==", b.load(b.gep(packets, [b.add(begin, i64(_place(PACKET, "mode")))])), i8(DUAL)
        )
        blocks = b.select(dual, b.udiv(blocks_if_dual, i64(2)), i64(_BLOCKS))
        to_other = b.select(dual, i64(_BLOCK.itemsize), i64(0))
        since, first, rate = number_at(since_s, packet), number_at(firsts, packet), number_at(rates, packet)
        b.store(i1(1), readable)
        with counting(b, i64(0), blocks) as block:
            block_begin = b.add(begin, b.mul(block, b.add(i64(_BLOCK.itemsize), to_other)))
            down = b.sub(i64(BANK_FLAGS[0]), word(block_begin))
            bank = b.udiv(down, i64(BANK_FLAGS[0] - BANK_FLAGS[1]))
            known = b.and_(
                b.icmp_unsigned("<", bank, banks),
                b.icmp_unsigned("==", b.mul(bank, i64(BANK_FLAGS[0] - BANK_FLAGS[1])), down),
            )
            azimuth = word(b.add(block_begin, i64(_place(_BLOCK, "azimuth"))))
            skipped = b.icmp_unsigned(">", azimuth, most_azimuth)
            # Nothing is read after a block of another kind.
            b.store(b.and_(b.load(readable), b.or_(known, skipped)), readable)
            with b.if_then(b.and_(b.load(readable), b.not_(skipped)), likely=True):
                azimuth = b.uitofp(b.trunc(azimuth, i32), f32)
                with counting(b, i64(0), i64(LASERS)) as laser:
                    fired = b.add(b.mul(block, i64(LASERS)), laser)
                    turned = b.fadd(azimuth, b.fmul(rate, number_at(turning_s, fired)))
                    whole = b.fptosi(b.call(halfway, [b.fadd(turned, f32(ALL_AZIMUTHS))]), i64)
                    at = b.urem(whole, i64(ALL_AZIMUTHS))
                    cosine, sine = number_at(cosines, at), number_at(sines, at)
                    own = b.mul(b.add(b.mul(bank, i64(LASERS)), laser), i64(6))
                    cos_own, sin_own, *others = (
                        number_at(traits, b.add(own, i64(trait))) for trait in range(6)
                    )
                    seen = [
                        b.fadd(b.fmul(cosine, cos_own), b.fmul(sine, sin_own)),
                        b.fsub(b.fmul(sine, cos_own), b.fmul(cosine, sin_own)),
                        *others,
                    ]
                    since_first = b.fpext(b.fadd(since, number_at(times_s, fired)), f64)
                    rounded = b.call(nearest, [b.fmul(since_first, f64(1e9))])
                    time = b.add(b.fptosi(rounded, i64), first)
                    returns_begin = b.add(block_begin, i64(_place(_BLOCK, "returns")))
                    last_at = b.add(returns_begin, b.mul(laser, i64(_RETURN)))
                    last = word(last_at)
                    strongest_at = b.add(last_at, to_other)
                    strongest = word(strongest_at)
                    with b.if_then(dual):
                        measured = b.icmp_unsigned("!=", last, i64(0))
                        counts = b.and_(measured, b.icmp_unsigned("!=", last, strongest))
                        put(last_at, last, counts, seen, time)
                    put(strongest_at, strongest, b.icmp_unsigned("!=", strongest, i64(0)), seen, time)
    b.store(b.load(taken), found)
    b.ret_void()
    return function


_EACH = MachineCode("each", _each_function)
_TAKE = MachineCode("take_returns", _take_function)
