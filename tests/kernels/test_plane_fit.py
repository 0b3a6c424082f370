from __future__ import annotations

import numpy as np
import pytest

from workbench.kernels.plane_fit import grid_planes, grid_spacing, smallest_eigenvector

RNG = np.random.default_rng(11)


def random_rotation() -> np.ndarray:
    q, r = np.linalg.qr(RNG.normal(size=(3, 3)))
    return q * np.sign(np.diag(r))


@pytest.mark.parametrize("scale", [1e-12, 1e-6, 1.0, 1e6, 1e12])
@pytest.mark.parametrize(
    "values",
    [(1, 2, 3), (0, 1, 1), (1, 1, 2), (1, 1 + 1e-12, 2), (1e-12, 1, 1 + 1e-12), (0, 0, 1),
     (1, 1, 1), (1e-9, 2e-9, 1), (0, 0, 0)],
)  # fmt: skip
def test_the_smallest_eigenpair_agrees_with_lapack(
    values: tuple[float, float, float], scale: float
) -> None:
    for _ in range(10):
        axes = random_rotation()
        matrix = (axes * (scale * np.array(values, float))) @ axes.T
        matrix = 0.5 * (matrix + matrix.T)
        xx, xy, xz, yy, yz, zz = matrix[np.triu_indices(3)]
        *found, x, y, z = smallest_eigenvector(xx, xy, xz, yy, yz, zz)
        expected, vectors = np.linalg.eigh(matrix)
        size = scale * max(values)
        assert np.abs(np.array(found) - expected).max() <= 4e-15 * size
        vector = np.array([x, y, z])
        assert np.linalg.norm(vector) == pytest.approx(1.0, abs=1e-14)
        assert np.linalg.norm(matrix @ vector - found[0] * vector) <= 4e-15 * size
        gap = (expected[1] - expected[0]) / size if size else 0.0
        if gap > 1e-3:
            assert abs(vector @ vectors[:, 0]) > 1 - 1e-10


def plain_planes(
    points: np.ndarray, grid: np.ndarray, half_window: int, step_m: np.ndarray
) -> tuple[np.ndarray, ...]:
    """The same by NumPy, one sample at a time."""
    n = len(points)
    normals, residual = np.zeros((n, 3)), np.zeros(n)
    neighbours, missing = np.zeros(n, int), np.full(n, 8)
    rows, cols = grid.shape
    for (r, c), i in np.ndenumerate(grid):
        if i < 0:
            continue
        used, ring = [], 0
        for rr in range(max(0, r - half_window), min(rows, r + half_window + 1)):
            for cc in range(max(0, c - half_window), min(cols, c + half_window + 1)):
                j, cells = grid[rr, cc], max(abs(rr - r), abs(cc - c))
                if j < 0 or np.linalg.norm(points[j] - points[i]) > step_m[i] * cells:
                    continue
                used.append(j)
                ring += cells == 1
        neighbours[i], missing[i] = len(used), 8 - ring
        if len(used) >= 3:
            centred = points[used] - points[used].mean(axis=0)
            _, spread, axes = np.linalg.svd(centred, full_matrices=False)
            normals[i], residual[i] = axes[2], spread[2] / np.sqrt(len(used))
    return normals, residual, neighbours, missing


@pytest.mark.parametrize("offset", [0.0, 5e6])
def test_planes_agree_with_plain_numpy(offset: float) -> None:
    rows, cols = 14, 17
    v, u = np.meshgrid(np.arange(rows), np.arange(cols), indexing="ij")
    z = 0.3 * np.sin(u / 3) + RNG.normal(scale=0.02, size=u.shape) + 4.0 * (u > 9)
    points = np.stack([u, v, z], axis=-1).reshape(-1, 3) + offset
    order = RNG.permutation(rows * cols)
    grid = np.empty(rows * cols, np.int32)
    grid[order] = np.arange(rows * cols)
    grid = np.where(RNG.random(rows * cols) < 0.15, -1, grid).reshape(rows, cols).astype(np.int32)
    points = points[order]
    step = np.full(len(points), 2.0)
    normals, residual, neighbours, missing = grid_planes(points, grid, 2, step)
    expected = plain_planes(points, grid, 2, step)
    assert np.array_equal(neighbours, expected[2])
    assert np.array_equal(missing, expected[3])
    assert np.abs(residual - expected[1]).max() < 1e-8
    agree = np.abs(np.einsum("ni,ni->n", normals, expected[0]))
    fitted = expected[2] >= 3
    assert agree[fitted].min() > 1 - 1e-9
    assert not normals[grid[grid >= 0]][~fitted[grid[grid >= 0]]].any()


def test_spacing_agrees_with_plain_numpy() -> None:
    grid = np.arange(80, dtype=np.int32).reshape(8, 10)
    grid[RNG.random(grid.shape) < 0.3] = -1
    points = RNG.normal(size=(80, 3))
    closest, fourth = grid_spacing(points, grid)
    for (r, c), i in np.ndenumerate(grid):
        if i < 0:
            continue
        around = grid[max(0, r - 1) : r + 2, max(0, c - 1) : c + 2].ravel()
        around = around[(around >= 0) & (around != i)]
        d = np.sort(np.linalg.norm(points[around] - points[i], axis=1))
        d = np.concatenate([d, np.full(4, np.inf)])
        assert closest[i] == pytest.approx(d[0])
        assert fourth[i] == pytest.approx(d[3])
    absent = np.setdiff1d(np.arange(80), grid)
    assert np.isinf(closest[absent]).all()


@pytest.mark.parametrize("half_window", [1, 2, 4])
def test_normals_of_a_noisy_plane_are_as_good_as_the_window_promises(half_window: int) -> None:
    spacing, sigma, n = 0.01, 0.0005, 60
    v, u = np.meshgrid(np.arange(n), np.arange(n), indexing="ij")
    points = np.stack([spacing * u, spacing * v, RNG.normal(scale=sigma, size=u.shape)], axis=-1)
    grid = np.arange(n * n, dtype=np.int32).reshape(n, n)
    step = np.full(n * n, 10 * spacing)
    normals, residual, neighbours, _ = grid_planes(points.reshape(-1, 3), grid, half_window, step)
    inside = grid[half_window:-half_window, half_window:-half_window].ravel()
    width = 2 * half_window + 1
    # Slope error of a least-squares plane over a full square window.
    slope = sigma / (spacing * np.sqrt(width**2 * (width**2 - 1) / 12))
    measured = np.abs(normals[inside, :2])
    assert np.sqrt(np.mean(measured**2)) == pytest.approx(slope, rel=0.15)
    assert (neighbours[inside] == width**2).all()
    expected = sigma * np.sqrt(1 - 3 / width**2)
    assert np.sqrt(np.mean(residual[inside] ** 2)) == pytest.approx(expected, rel=0.05)


def test_a_depth_step_is_not_smoothed_over() -> None:
    n = 20
    v, u = np.meshgrid(np.arange(n), np.arange(n), indexing="ij")
    points = np.stack([u, v, 50.0 * (u >= 10)], axis=-1).astype(float).reshape(-1, 3)
    grid = np.arange(n * n, dtype=np.int32).reshape(n, n)
    normals, residual, _, missing = grid_planes(points, grid, 2, np.full(n * n, 4.0))
    assert np.abs(normals[:, 2]).min() > 1 - 1e-12
    assert residual.max() < 1e-6
    assert (missing.reshape(n, n)[1:-1, 9:11] == 3).all()


def test_empty_grids_and_lines_have_no_normals() -> None:
    points = np.column_stack([np.arange(5.0), np.zeros(5), np.zeros(5)])
    line = np.arange(5, dtype=np.int32)[None]
    step = np.full(5, 10.0)
    assert not grid_planes(points, line, 2, step)[0].any()
    nothing = np.full((4, 6), -1, np.int32)
    normals, _, neighbours, missing = grid_planes(points, nothing, 2, step)
    assert not normals.any()
    assert not neighbours.any()
    assert (missing == 8).all()
    assert np.isinf(grid_spacing(points, nothing)[0]).all()
    assert grid_planes(np.zeros((0, 3)), nothing, 2, np.zeros(0))[0].shape == (0, 3)


def test_samples_that_are_not_numbers_do_not_spread_beyond_their_window() -> None:
    n = 12
    v, u = np.meshgrid(np.arange(n), np.arange(n), indexing="ij")
    points = np.stack([u, v, np.zeros((n, n))], axis=-1).astype(float)
    grid = np.arange(n * n, dtype=np.int32).reshape(n, n)
    points[3, 3] = np.nan
    normals = grid_planes(points.reshape(-1, 3), grid, 1, np.full(n * n, 3.0))[0].reshape(n, n, 3)
    assert np.array_equal(np.abs(normals[6:, 6:, 2]), np.ones((6, 6)))
