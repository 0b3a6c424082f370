"""The entropy-coded octree: chances, nothing lost, and what is refused."""

from __future__ import annotations

import zlib

import numpy as np
import pytest

from tests.pointcodecs.cubes import all_positions, by_cube, isolated, random_cubes, shell
from workbench.errors import InputError
from workbench.kernels import adaptive_bits
from workbench.kernels.adaptive_bits import (
    AT,
    coded_bit,
    finish_writing,
    new_chances,
    new_coder,
    new_weights,
    start_reading,
    was_read_whole,
)
from workbench.pointcodecs.codecs import CODECS

CONTEXT = CODECS["context"]
_SAME = (0, 0, 0, 0, 0)


def ball(level: int) -> np.ndarray:
    """Cells that a sphere passes through, told by whole numbers alone."""
    side = 1 << level
    twice = (2 * all_positions(level) + 1 - side).astype(np.int64)
    far = ((np.abs(twice) + 1) ** 2).sum(axis=1)
    near = (np.maximum(np.abs(twice) - 1, 0) ** 2).sum(axis=1)
    radius = (side - 3) ** 2
    return all_positions(level)[(near < radius) & (radius <= far)]


def test_the_logistic_function_is_known_to_its_last_place():
    logits = np.arange(-2048, 2048) / 256
    exact = np.clip(65536 / (1 + np.exp(-logits)), 24, 65536 - 24)

    assert np.abs(adaptive_bits._SQUASHED - exact).max() <= 1
    # The logit of a chance undoes it, to a step of the table.
    back = adaptive_bits._LOGIT[adaptive_bits._SQUASHED[256:-256] >> 4]
    slack = np.maximum(4, 16 * 256 * 65536 / (exact * (65536 - exact)))[256:-256]
    assert (np.abs(back - 256 * logits[256:-256]) <= slack).all()


@pytest.mark.parametrize("chance", [0.5, 0.1, 0.01])
def test_bits_cost_their_entropy_and_come_back(chance):
    bits = (np.random.default_rng(3).random(40_000) < chance).astype(np.int64)
    data = np.zeros(10_000, np.uint8)
    writer, chances, weights = new_coder(reading=False), new_chances(1), new_weights(1)
    for bit in bits:
        coded_bit(writer, data, chances, weights, 0, _SAME, bit)
    size = finish_writing(writer, data)

    share = bits.mean()
    entropy = -len(bits) * (share * np.log2(share) + (1 - share) * np.log2(1 - share))
    assert entropy < 8 * size < 1.03 * entropy + 200
    reader, chances, weights = new_coder(reading=True), new_chances(1), new_weights(1)
    start_reading(reader, data[:size])
    back = [coded_bit(reader, data[:size], chances, weights, 0, _SAME, 0) for _ in bits]
    np.testing.assert_array_equal(back, bits)
    assert was_read_whole(reader, data[:size])


def test_a_writer_without_room_says_how_much_it_takes():
    bits = np.random.default_rng(4).integers(0, 2, 4000)
    sizes = []
    for room in (10, 2000):
        data = np.zeros(room, np.uint8)
        writer, chances, weights = new_coder(reading=False), new_chances(1), new_weights(1)
        for bit in bits:
            coded_bit(writer, data, chances, weights, 0, _SAME, bit)
        sizes.append((finish_writing(writer, data), writer[AT]))

    assert sizes[0] == (-1, sizes[1][1])
    assert sizes[1][1] <= sizes[1][0] <= sizes[1][1] + 4


@pytest.mark.parametrize("level", [1, 2, 3, 5])
def test_nothing_is_lost_in_random_cubes(level):
    points, starts = random_cubes(150, level, 300, seed=level)

    coded = CONTEXT.encoded(points, starts, level)
    back = CONTEXT.decoded(coded.data, coded.bytes_at, starts, level)

    np.testing.assert_array_equal(back, points[coded.order])
    assert len(np.unique(coded.order)) == len(points)


@pytest.mark.slow
def test_nothing_is_lost_in_ten_thousand_random_cubes():
    points, starts = random_cubes(10_000, 5, 300, seed=11)

    coded = CONTEXT.encoded(points, starts, 5)
    back = CONTEXT.decoded(coded.data, coded.bytes_at, starts, 5)

    np.testing.assert_array_equal(back, points[coded.order])


@pytest.mark.parametrize(
    ("points", "most"),
    [(all_positions(6), 400), (all_positions(6)[12345:12346], 8), (isolated(4), 250)],
    ids=["full", "one", "isolated"],
)
def test_regular_cubes_take_next_to_nothing(points, most):
    level = 6 if len(points) != 512 else 4
    starts = np.array([0, len(points)])
    coded = CONTEXT.encoded(points, starts, level)

    assert 0 < len(coded.data) <= most
    back = CONTEXT.decoded(coded.data, coded.bytes_at, starts, level)
    np.testing.assert_array_equal(back, points[coded.order])


@pytest.mark.parametrize(("thick", "most"), [(True, 0.66), (False, 1.14)])
def test_a_smooth_surface_costs_less_than_an_octree_of_g_pcc(thick, most):
    points, starts = by_cube(shell(8, thick=thick), 8)
    coded = CONTEXT.encoded(points, starts, 8)

    # 1.2 × 0.95, its bits at 256³ on closed scans.
    assert 8 * len(coded.data) / len(points) <= most


def test_the_bytes_of_a_codec_do_not_change():
    # A file must be read by later versions: a change here is a change of the format.
    points = ball(5)
    starts = np.array([0, len(points)])
    prints = {
        name: (len(data), zlib.crc32(data))
        for name, codec in CODECS.items()
        for data in [codec.encoded(points, starts, 5).data.tobytes()]
    }

    assert len(points) == 3992
    assert prints == {
        "ci": (1528, 3242204172),
        "eci": (3257, 3320282703),
        "context": (285, 2860709824),
    }


def test_bytes_cut_short_or_changed_are_refused_or_other_points():
    points, starts = random_cubes(24, 4, 200, seed=5)
    coded = CONTEXT.encoded(points, starts, 4)
    rng = np.random.default_rng(6)

    for begin, end, low, high in zip(
        starts[:-1], starts[1:], coded.bytes_at[:-1], coded.bytes_at[1:], strict=True
    ):
        whole = coded.data[low:high]
        count = np.array([0, end - begin])
        damaged = [whole[:length] for length in range(0, len(whole), 1 + len(whole) // 20)]
        for _ in range(10 if len(whole) else 0):
            broken = whole.copy()
            broken[rng.integers(len(whole))] ^= 1 << rng.integers(8)
            damaged.append(broken)
        for data in damaged:
            try:
                back = CONTEXT.decoded(data, np.array([0, len(data)]), count, 4)
            except InputError:
                continue
            # A sum over the file's bytes notices these; here they are points all the same.
            assert (back >= 0).all()
            assert (back < 16).all()
            assert len(np.unique(back, axis=0)) == end - begin


def test_more_points_than_bytes_can_hold_are_refused_before_room_is_made():
    with pytest.raises(InputError, match="damaged") as caught:
        CONTEXT.decoded(np.zeros(3, np.uint8), np.array([0, 3]), np.array([0, 1 << 24]), 8)

    assert "16777216 points in 3 bytes" in str(caught.value)
