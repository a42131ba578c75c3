"""Finding markers in the data of a JPEG scan: 0xff before anything but the zero that follows it in data."""

import re

import numpy as np

from bagassets.geometry.kernels.machine_code import Ir, MachineCode, begin_function, counting, everywhere

_LANES = 32  # bytes that are compared together
_MOST = 4096  # markers that are found by one call
_WINDOW = 1 << 17  # bytes that are looked into at once
_MARKER = re.compile(rb"\xff(?=[^\x00])")


def markers_from(data: memoryview, at: int) -> list[int]:
    """Return where markers stand from `at` on: the first ones, at least one if there is any.

    Of 0xff repeated, which may stand before a marker, the last one counts. For more, ask
    again, from behind the last.
    """
    while at < len(data) - 1:
        window = data[at : at + _WINDOW + 1]  # with the byte that follows the last one
        places, looked_at = _in_window(window)
        found = [at + place for place in places if window[place + 1] != 0xFF]
        if found:
            return found
        at += looked_at
    return []


def _in_window(window: memoryview) -> tuple[list[int], int]:
    """Return where 0xff stands before anything but zero, and how many bytes were looked at."""
    function, rest = _FIND.function(), 0
    places: list[int] = []
    if function is not None:
        groups = (len(window) - 1) // _LANES
        found = np.zeros(_MOST + 1, np.int64)
        function(np.frombuffer(window, np.uint8).ctypes.data, found.ctypes.data, groups)
        places = found[1 : 1 + int(found[0])].tolist()
        if len(places) == _MOST:
            return places, places[-1] + 1
        rest = groups * _LANES
    # What is left, or all of it where there is no machine code.
    return [*places, *(rest + match.start() for match in _MARKER.finditer(window[rest:]))], len(window) - 1


def _find_function() -> Ir:
    """Return the function: bytes, number of markers found and where they are, number of groups to look into."""
    from llvmlite import ir

    i8, i32, i64 = ir.IntType(8), ir.IntType(32), ir.IntType(64)
    group_type = ir.VectorType(i8, _LANES)
    function, b = begin_function("find_markers", [i8, i64, None])
    data, found, groups = function.args
    lanes_255, lanes_0 = everywhere(b, i8(0xFF), _LANES), everywhere(b, i8(0), _LANES)
    with counting(b, i64(0), groups) as group:
        begin = b.mul(group, i64(_LANES))
        here, after = (
            b.load(b.bitcast(b.gep(data, [b.add(begin, i64(shift))]), group_type.as_pointer()), align=1)
            for shift in (0, 1)
        )
        marks = b.and_(b.icmp_unsigned("==", here, lanes_255), b.icmp_unsigned("!=", after, lanes_0))
        bits = b.bitcast(marks, i32)
        with (
            b.if_then(b.icmp_unsigned("!=", bits, i32(0)), likely=False),
            counting(b, i64(0), i64(_LANES)) as lane,
        ):
            number = b.load(found)
            is_marked = b.trunc(b.lshr(bits, b.trunc(lane, i32)), ir.IntType(1))
            with b.if_then(b.and_(is_marked, b.icmp_signed("<", number, i64(_MOST)))):
                number = b.add(number, i64(1))
                b.store(b.add(begin, lane), b.gep(found, [number]))
                b.store(number, found)
    b.ret_void()
    return function


_FIND = MachineCode("find_markers", _find_function)
