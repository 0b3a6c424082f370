"""Quantities as people read them: lengths in a fitting unit, durations, sizes in memory."""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass

MISSING = "–"
# A model of photographs alone may have no scale. Nobody who shows one of its lengths need know:
# it is shown in the unit of the model, as long as `without_scale` is entered.
_has_scale: ContextVar[bool] = ContextVar("_has_scale", default=True)


@dataclass(frozen=True)
class LengthUnit:
    """A unit of length; ``per_metre`` of them make a metre."""

    symbol: str
    per_metre: float


MICROMETRE = LengthUnit("µm", 1e6)
MILLIMETRE = LengthUnit("mm", 1e3)
METRE = LengthUnit("m", 1.0)
THOUSANDTH = LengthUnit("u/1000", 1e3)
OWN_UNIT = LengthUnit("u", 1.0)


@contextmanager
def without_scale() -> Iterator[None]:
    """Within it lengths are shown in a unit of the model's own, u, for it has no scale."""
    token = _has_scale.set(False)
    try:
        yield
    finally:
        _has_scale.reset(token)


def has_scale() -> bool:
    """Whether lengths that are shown are metres."""
    return _has_scale.get()


def shown_unit(symbol: str) -> str:
    """The symbol of a unit as it is shown: ``u`` for ``m``, ``u²`` for ``m²`` without scale."""
    lengths = {"m": "u", "m²": "u²", "mm": "u/1000"}
    return symbol if has_scale() else lengths.get(symbol, symbol)


def length_unit(typical_m: float) -> LengthUnit:
    """The unit in which a typical length (metres) reads as a handy number.

    Examples
    --------
    >>> length_unit(7e-5).symbol, length_unit(3e-6).symbol, length_unit(12.0).symbol
    ('mm', 'µm', 'm')
    """
    size = abs(typical_m)
    if not has_scale():
        return THOUSANDTH if size < 0.5 else OWN_UNIT
    if 0 < size < 1e-5:
        return MICROMETRE
    return MILLIMETRE if size < 0.5 else METRE


def shown_length(length_m: float, unit: LengthUnit | None = None, digits: int = 3) -> str:
    """A length with its unit, to ``digits`` significant digits at most.

    Examples
    --------
    >>> shown_length(7.1234e-5), shown_length(0.15612)
    ('0.0712 mm', '156 mm')
    """
    if not math.isfinite(length_m):
        return MISSING
    unit = unit or length_unit(length_m)
    return f"{shown_number(length_m * unit.per_metre, digits)} {unit.symbol}"


def shown_number(value: float | int | bool | None, digits: int = 4) -> str:
    """A number to ``digits`` significant digits, thousands apart; powers only when extreme.

    Examples
    --------
    >>> shown_number(0.000123456), shown_number(1234567), shown_number(3.0), shown_number(2e-9)
    ('0.0001235', '1\u202f234\u202f567', '3', '2e-09')
    """
    if value is None:
        return MISSING
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, int):
        return f"{value:,}".replace(",", "\u202f").replace("-", "−")
    if not math.isfinite(value):
        return MISSING
    if value != 0 and not 1e-5 <= abs(value) < 1e7:
        return f"{value:.3g}"
    decimals = digits - 1 - math.floor(math.log10(abs(value))) if value else 0
    text = f"{value:,.{max(decimals, 0)}f}"
    if "." in text:
        text = text.rstrip("0").rstrip(".")
    return text.replace(",", "\u202f").replace("-", "−")


def shown_percent(share: float) -> str:
    """A share in [0, 1] as a percentage that says 100 or 0 only when that is exact.

    Examples
    --------
    >>> shown_percent(0.9634), shown_percent(1.0), shown_percent(0.99999)
    ('96.3 %', '100 %', '> 99.9 %')
    """
    if not math.isfinite(share):
        return MISSING
    percent = 100 * share
    if percent in (0, 100):
        return f"{percent:.0f} %"
    if percent > 99.95:
        return "> 99.9 %"
    return "< 0.1 %" if percent < 0.05 else f"{percent:.1f} %"


def shown_duration(seconds: float) -> str:
    """A duration in words.

    Examples
    --------
    >>> shown_duration(0.84), shown_duration(125), shown_duration(7322)
    ('0.84 s', '2 min 5 s', '2 h 2 min')
    """
    if not math.isfinite(seconds):
        return MISSING
    if seconds < 60:
        return f"{shown_number(float(seconds), 2)} s"
    whole = round(seconds)
    if whole < 3600:
        return f"{whole // 60} min {whole % 60} s"
    minutes = round(seconds / 60)
    return f"{minutes // 60} h {minutes % 60} min"


def shown_bytes(count: float) -> str:
    """A size in decimal units.

    Examples
    --------
    >>> shown_bytes(1_234_567), shown_bytes(512)
    ('1.23 MB', '512 B')
    """
    if not math.isfinite(count):
        return MISSING
    size, units = float(count), ["B", "kB", "MB", "GB", "TB"]
    while size >= 999.5 and len(units) > 1:
        size /= 1000
        units.pop(0)
    return f"{shown_number(size, 3)} {units[0]}"


def round_up_125(value: float) -> float:
    """The next number of the series …, 1, 2, 5, 10, … at or above a positive value.

    Examples
    --------
    >>> round_up_125(0.00031)
    0.0005
    """
    power = 10.0 ** math.floor(math.log10(value))
    for step in (1, 2, 5, 10):
        rounded = float(f"{step * power:.12g}")
        if rounded >= value * (1 - 1e-9):
            return rounded
    return rounded
