"""Damage to files that knows what files are made of: numbers, counts, names, nesting."""

from __future__ import annotations

import random
import re
import struct
from collections.abc import Callable, Sequence

LONGEST = 1 << 16
_HEAD = 512

_WORDS = (
    *(b"0", b"-0", b"-1", b"1", b"2", b"255", b"256", b"65535", b"65536", b"2147483647"),
    *(b"2147483648", b"4294967295", b"9223372036854775807", b"9223372036854775808"),
    *(b"-9223372036854775809", b"18446744073709551616", b"99999999999999999999999", b"1e308"),
    *(b"-1e308", b"1e309", b"5e-324", b"1e-320", b"nan", b"-nan", b"inf", b"-inf", b"1_0"),
    *(b"0x10", b"1e", b".", b"-", b"1.5", b"007", b"true", b"null", b'""', b"[]", b"{}"),
    *(b"[[1]]", b"1e999999999", b"9" * 400, b"9" * 5000),
)
_NAMES = (
    *(b"../../../../etc/passwd", b"/etc/passwd", b"..", b".", b"/", b"C:\\x", b"..\\..\\x"),
    *(b"%2e%2e%2f", b"a\0b", b"\xff\xfe", b"\xe2\x80\xae", b"a" * 300, b"~/x", b"file:///x"),
    *(b"http://127.0.0.1:9/x", b"/dev/zero", b"/dev/stdin", b"__class__", b"{0.__class__}", b"%n"),
)
_NESTING = ((b"[", b"]"), (b"{", b"}"), (b'{"a":', b"}"), (b"<a>", b"</a>"), (b"(", b")"))
_WHOLE = (
    *(0, 1, 2, 3, 7, 8, 127, 128, 255, 256, 32767, 32768, 65535, 65536, 2**24, 2**31 - 1, 2**31),
    *(2**32 - 1, 2**32, 2**53, 2**62, 2**63 - 1, 2**63, 2**64 - 1, 2**64 - 2),
)
_REAL = (0.0, -0.0, 1.0, -1.0, 1e308, -1e308, 5e-324, float("nan"), float("inf"), float("-inf"))
_NUMBER = re.compile(rb"[-+]?[0-9]+(?:\.[0-9]*)?(?:[eE][-+]?[0-9]+)?")
_WORD = re.compile(rb"[^\s<>\"=,;:\[\]{}]+")


class Mutator:
    """Files like some seeds, each with a little damage; the same seed gives the same files.

    Parameters
    ----------
    seeds : contents of good files, one of which is damaged each time; may grow meanwhile.
    chance : where all choices come from.
    """

    def __init__(self, seeds: Sequence[bytes], chance: random.Random) -> None:
        self._seeds = seeds
        self._chance = chance
        # Some kinds twice: what is wrong with a file is most often one number.
        self._kinds: tuple[Callable[[bytearray], None], ...] = (
            self._flip_bit,
            self._set_byte,
            self._set_whole,
            self._set_whole,
            self._set_real,
            self._cut,
            self._remove,
            self._repeat,
            self._splice,
            self._replace_number,
            self._replace_number,
            self._replace_number,
            self._replace_word,
            self._name,
            self._nest,
            self._line,
            self._fill,
        )

    def damaged(self, content: bytes) -> bytes:
        """The content with one to five pieces of damage."""
        data = bytearray(content)
        for _ in range(1 + min(int(self._chance.expovariate(0.8)), 4)):
            self._chance.choice(self._kinds)(data)
        return bytes(data[:LONGEST])

    def _place(self, size: int) -> int:
        """Somewhere in so many bytes, half of the time near the start, where counts are."""
        if size <= 0:
            return 0
        return self._chance.randrange(min(size, _HEAD) if self._chance.random() < 0.5 else size)

    def _flip_bit(self, data: bytearray) -> None:
        if data:
            data[self._place(len(data))] ^= 1 << self._chance.randrange(8)

    def _set_byte(self, data: bytearray) -> None:
        if data:
            data[self._place(len(data))] = self._chance.choice((0, 1, 127, 128, 254, 255, 10, 32))

    def _set_whole(self, data: bytearray) -> None:
        size = self._chance.choice((1, 2, 4, 4, 8, 8))
        at = self._place(len(data) - size + 1)
        if self._chance.random() < 0.5:
            at -= at % min(size, 4)
        order = self._chance.choice(("little", "little", "big"))
        old = int.from_bytes(data[at : at + size], order)
        value = self._chance.choice(_WHOLE)
        if self._chance.random() < 0.3:
            value = old + self._chance.choice((-2, -1, 1, 2, 16, 256))
        data[at : at + size] = (value % (1 << 8 * size)).to_bytes(size, order)

    def _set_real(self, data: bytearray) -> None:
        letter = self._chance.choice(("<f", "<d", "<d", ">f", ">d"))
        size = struct.calcsize(letter)
        at = self._place(len(data) - size + 1)
        value = self._chance.choice(_REAL)
        if abs(value) < 1e38 or value != value or abs(value) == float("inf"):
            data[at : at + size] = struct.pack(letter, value)

    def _cut(self, data: bytearray) -> None:
        del data[self._chance.randrange(len(data) + 1) :]

    def _remove(self, data: bytearray) -> None:
        at = self._place(len(data))
        del data[at : at + self._chance.choice((1, 2, 4, 8, 16, 64, 512))]

    def _repeat(self, data: bytearray) -> None:
        at = self._place(len(data))
        piece = data[at : at + self._chance.choice((1, 4, 12, 16, 64, 512))]
        data[at:at] = piece * self._chance.choice((1, 1, 2, 8, 64))

    def _splice(self, data: bytearray) -> None:
        other = self._chance.choice(self._seeds)
        start = self._place(len(other))
        piece = other[start : start + self._chance.choice((4, 16, 64, 1024))]
        at = self._place(len(data))
        end = at + len(piece) if self._chance.random() < 0.5 else at
        data[at:end] = piece

    def _spot(self, pattern: re.Pattern[bytes], data: bytearray) -> re.Match[bytes] | None:
        return pattern.search(data, self._place(len(data)))

    def _replace_number(self, data: bytearray) -> None:
        found = self._spot(_NUMBER, data)
        if found is not None:
            data[found.start() : found.end()] = self._chance.choice(_WORDS)

    def _replace_word(self, data: bytearray) -> None:
        found, other = self._spot(_WORD, data), self._spot(_WORD, data)
        if found is not None and other is not None:
            data[found.start() : found.end()] = other.group()

    def _name(self, data: bytearray) -> None:
        found = self._spot(_WORD, data)
        if found is not None:
            data[found.start() : found.end()] = self._chance.choice(_NAMES)

    def _nest(self, data: bytearray) -> None:
        opening, closing = self._chance.choice(_NESTING)
        depth = self._chance.choice((1, 2, 30, 300, 3000))
        at = self._place(len(data))
        data[at:at] = opening * depth + (closing * depth if self._chance.random() < 0.5 else b"")

    def _line(self, data: bytearray) -> None:
        lines = bytes(data).split(b"\n")
        at = self._chance.randrange(len(lines))
        match self._chance.randrange(3):
            case 0:
                del lines[at]
            case 1:
                lines.insert(at, self._chance.choice(lines))
            case _:
                lines[at] = b" ".join(reversed(lines[at].split()))
        data[:] = b"\n".join(lines)

    def _fill(self, data: bytearray) -> None:
        at = self._place(len(data))
        size = self._chance.choice((4, 16, 64, 256))
        data[at : at + size] = bytes([self._chance.choice((0, 255, 1, 32))]) * size
