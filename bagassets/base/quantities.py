"""Numbers as people read them: with a noun in the singular or plural, with a unit, or as a date."""

from datetime import UTC, datetime

_LONG_S = 1_000 * 3_600  # as between the epoch and today, in a recording with unset stamps


def count_text(number: int, noun: str) -> str:
    """Return a number with its noun: `1 recording`, `2 recordings`, `2 boxes`."""
    plural = "es" if noun.endswith("x") else "s"
    return f"{number} {noun}{'' if number == 1 else plural}"


def readable_bytes(size: int) -> str:
    """Return a number of bytes with a unit: `999 B`, `1.2 MB`."""
    if size < 1000:
        return f"{size} B"
    value = float(size)
    for unit in ("kB", "MB", "GB"):
        value /= 1000
        if value < 999.95:
            return f"{value:.1f} {unit}"
    return f"{value / 1000:.1f} TB"


def readable_time(seconds: float) -> str:
    """Return a rough duration with a unit: `20 s`, `40 min`, `1.5 h`."""
    if seconds < 99.5:
        return f"{max(1, round(seconds))} s"
    return f"{seconds / 60:.0f} min" if seconds < 5970 else f"{seconds / 3600:.1f} h"


def readable_length(length_m: float) -> str:
    """Return a length in metres with a unit: `12 m`, `1.2 km`."""
    return f"{length_m:.0f} m" if length_m < 999.5 else f"{length_m / 1000:,.1f} km"


def span_text(seconds: float | None) -> str:
    """Return a duration: `7.5 s`, `2:03 min`, `1:02:03 h`, `20,252 days`."""
    if seconds is None:
        return ""
    if seconds < 60:
        return f"{seconds:.1f} s"
    if seconds >= _LONG_S:
        return f"{seconds / 86_400:,.0f} days"
    return f"{clock_text(seconds)} {'h' if round(seconds) >= 3600 else 'min'}"


def clock_text(seconds: float) -> str:
    """Return a duration as minutes and seconds, with hours where there are any: `2:03`, `1:02:03`."""
    minutes, rest = divmod(round(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours}:{minutes:02}:{rest:02}" if hours else f"{minutes}:{rest:02}"


def utc_text(stamp_ns: int) -> str:
    """Return a time to the millisecond: `2026-11-21T07:30:03.125Z`."""
    second = datetime.fromtimestamp(stamp_ns // 10**9, UTC)
    return f"{second:%Y-%m-%dT%H:%M:%S}.{stamp_ns // 10**6 % 1000:03}Z"
