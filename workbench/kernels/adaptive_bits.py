"""Binary arithmetic coding of bits whose chance several adaptive contexts tell together.

Every context holds a chance and how often it was met; a small set of weights, itself learnt,
adds what the contexts say in the logistic domain (Mahoney 2005, "Adaptive weighing of context
models for lossless data compression"). All arithmetic is in integers, tables included: a
stream decodes alike on every machine.

A coder is one array of int64 (`new_coder`): it writes or reads, and `coded_bit` does whichever
it was made for, so that the walk that calls it is the same code for both and cannot disagree
with itself.
"""

from __future__ import annotations

from decimal import Decimal, localcontext

import numpy as np
from numba import njit
from numpy.typing import NDArray

CONTEXTS = 5
LOW, HIGH, WINDOW, AT, READING = range(5)
# A chance is never so close to certain that a bit costs less than 0.0005 or more than 11.5.
_SURE = 24
_FRACTION = 80
_COUNT_BITS, _MOST_COUNTED = 10, 255
_LEARNING = 6


def _squash_table() -> NDArray[np.uint16]:
    """Chances in 1/65536 of the logits −2048…2047, in 1/256."""
    with localcontext() as context:
        context.prec = 40
        step = int((Decimal(1) / 256).exp() * (1 << _FRACTION))
    one = 1 << _FRACTION
    power = [one]
    for _ in range(2048):
        power.append(power[-1] * step >> _FRACTION)
    up = [(power[d] << 16) // (power[d] + one) for d in range(2048)]
    down = [(one << 16) // (power[d] + one) for d in range(2048, 0, -1)]
    return np.array([min(max(p, _SURE), 65536 - _SURE) for p in down + up], np.uint16)


# Tables are of the smallest types that hold them, to stay in the nearest cache.
_SQUASHED = _squash_table()
# Of chances in 1/4096, taken at the middle of each step.
_LOGIT = np.clip(np.searchsorted(_SQUASHED, np.arange(4096) * 16 + 8) - 2048, -2047, 2047).astype(
    np.int16
)
# A chance moves by 1 / (n + 1.6) of the surprise at the n-th meeting.
_STEP = (655360 // (10 * np.arange(_MOST_COUNTED + 1) + 16)).astype(np.uint16)


def new_chances(number: int) -> NDArray[np.uint32]:
    """Contexts that know nothing yet: one half, 22 bits, and no meetings, 10 bits."""
    return np.full(number, 1 << 31, np.uint32)


def open_minded(chances: NDArray[np.uint32], meetings: int) -> NDArray[np.uint32]:
    """The same chances, as if each had been met ``meetings`` times at most."""
    counted = chances & np.uint32((1 << _COUNT_BITS) - 1)
    return np.asarray(chances - counted + np.minimum(counted, np.uint32(meetings)), np.uint32)


def new_weights(sets: int) -> NDArray[np.int64]:
    """(sets, CONTEXTS) weights in 1/65536, before anything is learnt."""
    return np.full((sets, CONTEXTS), 19660, np.int64)


def new_coder(*, reading: bool) -> NDArray[np.int64]:
    """A coder at the start of its bytes; `start_reading` comes next where it reads."""
    coder = np.zeros(5, np.int64)
    coder[HIGH], coder[READING] = 0xFFFFFFFF, reading
    return coder


@njit(cache=True, nogil=True)
def start_reading(coder: NDArray[np.int64], data: NDArray[np.uint8]) -> None:
    """Take in the first four bytes."""
    for _ in range(4):
        coder[WINDOW] = coder[WINDOW] << 8 | _next_byte(coder, data)


@njit(cache=True, nogil=True)
def _next_byte(coder: NDArray[np.int64], data: NDArray[np.uint8]) -> int:
    """Zeros follow the bytes: the writer leaves such an end out."""
    at = coder[AT]
    coder[AT] = at + 1
    if at < len(data):
        return int(np.int64(data[at]))
    return 0


@njit(cache=True, nogil=True)
def finish_writing(coder: NDArray[np.int64], data: NDArray[np.uint8]) -> int:
    """Write the shortest end that tells the last bits; the bytes that count, or −1: no room.

    A reader then asks for four bytes more than there are at most, and leaves none.
    """
    # Some value of LOW…HIGH with as many zero bytes at its end as can be.
    low, high = coder[LOW], coder[HIGH]
    value = high
    for zeros in (32, 24, 16, 8):
        candidate = (high >> zeros) << zeros
        if candidate >= low:
            value = candidate
            break
    at = int(coder[AT])
    if at + 4 > len(data):
        return -1
    for shift in (24, 16, 8, 0):
        if value & ((1 << (shift + 8)) - 1) == 0:
            break
        data[at] = value >> shift & 0xFF
        at += 1
    return at


@njit(cache=True, nogil=True)
def was_read_whole(coder: NDArray[np.int64], data: NDArray[np.uint8]) -> bool:
    """Whether the bytes read end where a writer of the same bits would have ended."""
    return bool(coder[AT] - 4 <= len(data) <= coder[AT])


@njit(cache=True, nogil=True)
def _arithmetic_bit(
    coder: NDArray[np.int64], data: NDArray[np.uint8], chance: int, bit: int
) -> int:
    """Write ``bit``, or read one; ``chance`` of a 1 in 1/65536."""
    low, high = coder[LOW], coder[HIGH]
    span = high - low
    middle = low + (span >> 16) * chance + ((span & 0xFFFF) * chance >> 16)
    if coder[READING]:
        bit = int(coder[WINDOW] <= middle)
    if bit:
        high = middle
    else:
        low = middle + 1
    while (low ^ high) & 0xFF000000 == 0:
        if coder[READING]:
            coder[WINDOW] = (coder[WINDOW] << 8 & 0xFFFFFFFF) | _next_byte(coder, data)
        else:
            at = coder[AT]
            if at < len(data):
                data[at] = high >> 24
            coder[AT] = at + 1
        low = low << 8 & 0xFFFFFFFF
        high = (high << 8 & 0xFFFFFFFF) | 0xFF
    coder[LOW], coder[HIGH] = low, high
    return bit


@njit(cache=True, nogil=True)
def _logit(chance: int) -> int:
    return int(np.int64(_LOGIT[chance >> 20]))


@njit(cache=True, nogil=True)
def _learnt(chance: int, bit: int) -> int:
    """A context after it met ``bit``."""
    count = chance & ((1 << _COUNT_BITS) - 1)
    p = chance >> _COUNT_BITS
    p += (((bit << 22) - p) >> 3) * int(np.int64(_STEP[count])) >> 13
    p = min(max(p, 0), (1 << 22) - 1)
    return p << _COUNT_BITS | min(count + 1, _MOST_COUNTED)


@njit(cache=True, nogil=True)
def coded_bit(
    coder: NDArray[np.int64],
    data: NDArray[np.uint8],
    chances: NDArray[np.uint32],
    weights: NDArray[np.int64],
    chosen: int,
    contexts: tuple[int, int, int, int, int],
    bit: int,
) -> int:
    """Write ``bit``, or read one, and learn from it.

    Parameters
    ----------
    coder, data
        See the module; ``data`` is read, or written as far as it reaches: the coder's place
        runs on, so that the writer finds out.
    chances
        Of `new_chances`.
    weights
        Of `new_weights`.
    chosen
        The set of weights.
    contexts
        Rows of ``chances``.
    bit
        What to write; a reader does not look at it.
    """
    a, b, c, d, e = contexts
    ca, cb, cc = np.int64(chances[a]), np.int64(chances[b]), np.int64(chances[c])
    cd, ce = np.int64(chances[d]), np.int64(chances[e])
    sa, sb, sc = _logit(ca), _logit(cb), _logit(cc)
    sd, se = _logit(cd), _logit(ce)
    w = weights[chosen]
    logit = (w[0] * sa + w[1] * sb + w[2] * sc + w[3] * sd + w[4] * se) >> 16
    chance = np.int64(_SQUASHED[min(max(logit, -2047), 2047) + 2048])
    bit = _arithmetic_bit(coder, data, chance, bit)
    surprise = ((bit << 16) - chance) * _LEARNING
    half = 1 << 17
    w[0] += (sa * surprise + half) >> 18
    w[1] += (sb * surprise + half) >> 18
    w[2] += (sc * surprise + half) >> 18
    w[3] += (sd * surprise + half) >> 18
    w[4] += (se * surprise + half) >> 18
    chances[a], chances[b], chances[c] = _learnt(ca, bit), _learnt(cb, bit), _learnt(cc, bit)
    chances[d], chances[e] = _learnt(cd, bit), _learnt(ce, bit)
    return bit
