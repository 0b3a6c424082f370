from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from workbench.formats.number_text import (
    as_bytes_array,
    byte_kinds,
    line_number,
    numbers_in_text,
)
from workbench.kernels.lzf import decompress_lzf


def read(text: bytes, count: int = 10**9, **options: object):
    return numbers_in_text(as_bytes_array(text), 0, count, **options)  # type: ignore[arg-type]


@given(
    st.lists(st.floats(allow_nan=False), min_size=1, max_size=30),
    st.sampled_from(["{!r}", "{:.6f}", "{:.16g}", "{:.17e}", "{:+.3e}", "{:.15g}"]),
)
@settings(max_examples=300, deadline=None)
def test_every_number_is_the_nearest_double(values, form):
    words = [form.format(value) for value in values]
    assert read(" ".join(words).encode()).values.tolist() == [float(word) for word in words]


@pytest.mark.parametrize(
    "word", ["1", "-0", ".5", "5.", "+3", "1e5", "1E-3", "1e400", "0" * 30 + "1"]
)
def test_the_forms_a_number_may_take(word):
    (value,) = read(word.encode()).values
    assert value == float(word)
    assert np.signbit(value) == np.signbit(float(word))


@pytest.mark.parametrize(
    "word", ["1_0", "0x10", "1,5", "1.5.5", "1-2", "e5", ".", "-", "1e", "12abc"]
)
def test_what_is_no_number_stops_the_reading_there(word):
    result = read(f"7 8 {word} 9".encode())
    assert result.values.tolist() == [7, 8]
    assert result.end == 4
    assert word in (result.problem or "")


@pytest.mark.parametrize(
    ("text", "line"),
    [(b"1 2 3\n4 5\n6 7 8 9\n", 2), (b"1 2 3\r\n\r\n4 5 6 7", 3), (b"1 2 3\r4 5 6\r7", 3)],
)
def test_a_ragged_line_is_found_even_where_the_total_fits(text, line):
    result = read(text, 9, columns=3)
    assert "should be 3" in (result.problem or "")
    assert line_number(as_bytes_array(text), result.end) == line


def test_comments_and_separators_are_what_the_format_says():
    result = read(b"1,2;3 # 9 9\n#4\n\n4\t5,6\n", columns=3, kinds=byte_kinds(b" \t,;", b"#"))
    assert result.values.tolist() == [1, 2, 3, 4, 5, 6]


def test_more_slow_numbers_than_are_resolved_at_once():
    values = np.random.default_rng(0).random(70_000)
    result = read("\n".join(map(repr, values.tolist())).encode(), columns=1)
    assert np.array_equal(result.values, values)


def test_lzf_refuses_what_points_outside():
    out = np.zeros(10, np.uint8)
    for packed in (
        b"\x20\x05",
        b"\x05abc",
        b"\xe0",
        b"\x00a\xe0\xff\x00",
        b"\x09" + b"a" * 10 + b"\x00b",
    ):
        assert decompress_lzf(np.frombuffer(packed, np.uint8), out) == -1
    assert decompress_lzf(np.frombuffer(b"\x01ab\x80\x01", np.uint8), out) == 8
    assert out[:8].tobytes() == b"abababab"
