"""Cell identification: the paper's bits, nothing lost, and what is refused."""

from __future__ import annotations

from itertools import pairwise
from time import process_time

import numpy as np
import pytest

from tests.pointcodecs.cubes import FIGURE, all_positions, by_cube, isolated, random_cubes, shell
from workbench.pointcodecs.codecs import CODECS

CI = CODECS["ci"]


def bits_of(points: np.ndarray, level: int) -> str:
    """The bits of one cube, padding and all."""
    coded = CI.encoded(points, np.array([0, len(points)]), level)
    return "".join(f"{byte:08b}" for byte in coded.data)


def points_of(bits: str, count: int, level: int) -> np.ndarray:
    """The points of one cube from its bits."""
    padded = bits + "0" * (-len(bits) % 8)
    data = np.array([int(padded[k : k + 8], 2) for k in range(0, len(padded), 8)], np.uint8)
    return CI.decoded(data, np.array([0, len(data)]), np.array([0, count]), level)


def plainly_coded(points: np.ndarray, level: int) -> str:
    """The bits as section 3.1 tells them, written without a thought of speed."""
    side, there = 1 << level, {tuple(point) for point in points.tolist()}
    bits = ""
    for x in range(0, side, 2):
        for y in range(0, side, 2):
            for z in range(0, side, 2):
                cell = [
                    (x + a, y + b, z + c) in there for a in (0, 1) for b in (0, 1) for c in (0, 1)
                ]
                bits += "1" + "".join(str(int(here)) for here in cell) if any(cell) else "0"
    return bits


def test_the_first_cell_of_figure_2_is_the_papers():
    bits = bits_of(FIGURE, 2)

    assert len(FIGURE) == 36
    # Section 3.1: "(1) {1, 1, 1, 1, 1, 1, 0, 0}".
    assert bits.startswith("1" + "11111100")
    # All eight cells of the cube have points here: 9 bits each.
    assert len(bits) == 72


def test_cell_67_lies_where_section_4_1_puts_it():
    # "(00000, 01000, 00110)" is position 0 of the cell with index 67.
    bits = "0" * 67 + "1" + "10000000" + "0" * (4096 - 68)

    np.testing.assert_array_equal(points_of(bits, 1, 5), [[0, 8, 6]])


def test_positions_of_a_cell_have_the_offsets_of_section_4_1():
    bits = "1" + "11111111" + "0" * 4095
    points = points_of(bits, 8, 5)

    np.testing.assert_array_equal(points[1], [0, 0, 1])
    np.testing.assert_array_equal(points[2], [0, 1, 0])
    np.testing.assert_array_equal(points @ [4, 2, 1], range(8))


@pytest.mark.parametrize(
    ("points", "bits"),
    [
        # 1.125 and 9 bits per point in cells that are not empty, and 1 bit per empty one.
        (all_positions(5), 9 * 4096),
        (isolated(5), 9 * 4096),
        (all_positions(5)[:1], 9 + 4095),
        (all_positions(5)[:0], 4096),
    ],
    ids=["full", "isolated", "one", "empty"],
)
def test_bits_are_those_of_the_paper(points, bits):
    assert len(bits_of(points, 5)) == -(-bits // 8) * 8


@pytest.mark.parametrize("level", [1, 2, 3, 5])
def test_the_bits_are_those_of_a_plain_encoder(level):
    points, starts = random_cubes(12, level, 40, seed=level)

    for begin, end in pairwise(starts):
        plain = plainly_coded(points[begin:end], level)
        assert bits_of(points[begin:end], level) == plain + "0" * (-len(plain) % 8)


def test_nothing_is_lost_in_ten_thousand_random_cubes():
    points, starts = random_cubes(10_000, 5, 1500, seed=1)

    coded = CI.encoded(points, starts, 5)
    back = CI.decoded(coded.data, coded.bytes_at, starts, 5)

    np.testing.assert_array_equal(back, points[coded.order])
    assert len(np.unique(coded.order)) == len(points)


def test_twenty_million_points_a_second_are_read():
    points, starts = by_cube(shell(8, thick=True), 5)
    coded = CI.encoded(points, starts, 5)
    seconds = []
    for _ in range(3):
        begin = process_time()
        CI.decoded(coded.data, coded.bytes_at, starts, 5)
        seconds.append(process_time() - begin)

    # Of this thread's own time; the first includes compiling.
    assert min(seconds) < len(points) / 20e6


def test_a_surface_costs_nine_bits_for_each_cell_and_one_for_each_empty_one():
    for level in (5, 6, 7):
        points, starts = by_cube(shell(level, thick=True), 5)
        coded = CI.encoded(points, starts, 5)

        cube = np.repeat(np.arange(len(starts) - 1), np.diff(starts))
        filled = np.unique(np.column_stack([cube, points >> 1]), axis=0)
        per_cube = 4096 + 8 * np.bincount(filled[:, 0])
        np.testing.assert_array_equal(np.diff(coded.bytes_at), -(-per_cube // 8))
