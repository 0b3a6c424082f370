from __future__ import annotations

from fractions import Fraction

import numpy as np
import pytest
from scipy.stats import entropy

from workbench.kernels import chunk_planes as kernels

RNG = np.random.default_rng(5)


def test_grid_exponents_are_the_finest_binary_grid():
    points = np.column_stack([RNG.random(50), RNG.integers(-9, 9, 50) * 0.125, np.zeros(50)])
    found = kernels.grid_exponents(points, points.view(np.uint64))
    for axis in range(2):
        scaled = [Fraction(v) / Fraction(2) ** int(found[axis]) for v in points[:, axis]]
        assert all(s.denominator == 1 for s in scaled)
        assert any(s.numerator % 2 for s in scaled)
    assert found[2] == 0


@pytest.mark.parametrize("odd", [-0.0, 5e-324, 1e-300])
def test_an_axis_no_grid_holds_is_told(odd: float):
    points = np.ones((3, 3))
    points[1, 1] = odd
    found = kernels.grid_exponents(points, points.view(np.uint64))
    assert found.tolist() == [0, kernels.NO_GRID, 0]


def test_codes_interleave_the_high_bits():
    local = RNG.integers(0, 1 << 40, (100, 3)).astype(np.uint64)
    shifts = np.array([19, 20, 25])
    codes = kernels.morton_codes(local, shifts)
    for row, code in zip(local.tolist(), codes.tolist(), strict=True):
        expected = 0
        for axis in range(3):
            high = row[axis] >> int(shifts[axis])
            for bit in range(21):
                expected |= ((high >> bit) & 1) << (3 * bit + axis)
        assert code == expected


@pytest.mark.parametrize("n", [0, 1, 2, 5000])
@pytest.mark.parametrize("bits", [1, 12, 63])
def test_sorting_is_stable(n: int, bits: int):
    codes = RNG.integers(0, 1 << bits, n, dtype=np.uint64)
    order, keys = kernels.sorted_order(codes)
    assert np.array_equal(order, np.argsort(codes, kind="stable"))
    assert np.array_equal(keys, codes[order])


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16, np.uint32, np.uint64])
def test_steps_are_zigzag_differences(dtype: type):
    top = int(np.iinfo(dtype).max)
    values = RNG.integers(0, top, 300, dtype=dtype, endpoint=True)
    values[:4] = [0, top, 0, top // 2]
    steps = kernels.zigzag_steps(values)
    previous = 0
    for value, step in zip(values.tolist(), steps.tolist(), strict=True):
        difference = (value - previous) % (top + 1)
        signed = difference - (top + 1) if difference > top // 2 else difference
        assert step == (2 * signed if signed >= 0 else -2 * signed - 1)
        previous = value
    back = kernels.from_zigzag_steps(steps)
    assert back.dtype == values.dtype
    assert np.array_equal(back, values)


def test_plane_bits_are_the_order_zero_entropy():
    planes = np.stack([RNG.integers(0, k, 999).astype(np.uint8) for k in (1, 3, 256)])
    expected = [999 * entropy(np.bincount(p), base=2) for p in planes]
    assert kernels.plane_bits(planes) == pytest.approx(expected, abs=1e-9)


def test_unit_vectors_come_back_with_every_bit_and_little_is_kept_of_the_third():
    vectors = RNG.normal(size=(2000, 3))
    vectors[:6] = np.vstack([np.eye(3), -np.eye(3)])
    vectors = (vectors / np.linalg.norm(vectors, axis=1)[:, None]).astype(np.float32)
    vectors[6] = [0.0, -0.0, -1.0]
    vectors[7] = [1.00004, 0.0, 0.0]
    unit, dropped, parts = kernels.unit_vector_parts(vectors, vectors.view(np.uint32))
    assert unit
    assert np.array_equal(kernels.unit_vectors_from_parts(dropped, parts), vectors.view(np.uint32))
    assert np.percentile(parts[2], 99) <= 4


@pytest.mark.parametrize("bad", [np.nan, np.inf, 0.9, 1.1])
def test_other_vectors_are_no_unit_vectors(bad: float):
    vectors = np.array([[0, 0, 1], [0, bad, 0]], np.float32)
    assert not kernels.unit_vector_parts(vectors, vectors.view(np.uint32))[0]
