"""Cubes of points for the tests of codecs."""

import numpy as np

# Agrees with all that the text of Mallón et al. 2003 says of its figures 1, 2 and 4: 4³
# positions, 36 points, cell 0 with the positions 0…5, ψ and seeds of the first two layers and
# of the first point of the third. The pictures are lost: the points beyond are free.
FIGURE = np.array(
    [[0, 0, 0], [0, 0, 1], [0, 1, 0], [0, 1, 1], [1, 0, 0], [1, 0, 1], [2, 1, 1], [2, 0, 0],
     [2, 0, 2], [1, 0, 2], [2, 1, 0], [0, 1, 2], [1, 2, 0], [1, 1, 2], [2, 0, 1], [0, 2, 0],
     [0, 2, 1], [1, 2, 1], [0, 2, 2], [1, 3, 3], [0, 1, 3], [1, 1, 3], [3, 1, 2], [2, 3, 0],
     [3, 2, 1], [0, 3, 2], [2, 3, 3], [3, 1, 1], [3, 3, 2], [3, 0, 2], [0, 3, 0], [0, 3, 1],
     [3, 2, 2], [0, 2, 3], [3, 3, 3], [3, 0, 0]],
    np.int32,
)  # fmt: skip


def all_positions(level: int) -> np.ndarray:
    """Every place of a cube, z fastest."""
    return np.argwhere(np.ones((1 << level,) * 3, bool)).astype(np.int32)


def isolated(level: int) -> np.ndarray:
    """As many points as fit without two being neighbours."""
    return 2 * all_positions(level - 1)


def random_cubes(count: int, level: int, most: int, seed: int):
    """Cubes one after another, and where each begins: sparse and dense, clustered and not.

    Among them are an empty cube, a full one, one with a single point, and one with only
    isolated points.
    """
    rng = np.random.default_rng(seed)
    side = 1 << level
    special = [all_positions(level)[:0], all_positions(level), isolated(level)[-1:]]
    cubes = [*special, isolated(level)]
    for number in np.exp(rng.uniform(0, np.log(most), count - len(cubes))).astype(int):
        spread = rng.choice([0.5, 2.0, side])
        middle = rng.uniform(0, side, 3)
        points = np.floor(middle + spread * rng.normal(size=(number, 3))).astype(np.int64) % side
        places = np.unique((points[:, 0] * side + points[:, 1]) * side + points[:, 2])
        cubes.append(np.stack([places // side**2, places // side % side, places % side], axis=1))
    points = np.concatenate(cubes).astype(np.int32)
    return points, np.concatenate([[0], np.cumsum([len(cube) for cube in cubes])])


def shell(level: int, thick: bool) -> np.ndarray:
    """Cells (n, 3) of a closed, bumpy surface in a grid of 2**level cells a side.

    Thick: all cells whose corners lie on both sides; else those whose middle lies inside and a
    face neighbour's outside, about 1.5 for each cell of area across the axes.
    """
    side = 1 << level
    at = np.arange(side + 1) if thick else np.arange(side) + 0.5
    x, y, z = np.meshgrid(*(3 * [at / side - 0.503]), indexing="ij", sparse=True)
    wave = 0.02 * np.sin(23 * x + 5 * z) * np.cos(17 * y - 3 * x)
    inside = np.sqrt(x**2 + 1.4 * y**2 + 1.2 * z**2) + wave < 0.43
    if thick:
        corners = [
            inside[a : side + a, b : side + b, c : side + c]
            for a in (0, 1) for b in (0, 1) for c in (0, 1)
        ]  # fmt: skip
        return np.argwhere(np.any(corners, axis=0) & ~np.all(corners, axis=0)).astype(np.int32)
    bare = np.zeros_like(inside)
    for axis in range(3):
        for shift in (-1, 1):
            bare |= ~np.roll(inside, shift, axis)
    return np.argwhere(inside & bare).astype(np.int32)


def by_cube(cells: np.ndarray, level: int):
    """Cells as points of cubes of 2**level a side, and where each cube begins."""
    cube = cells >> level
    number = (cube[:, 0] << 20) + (cube[:, 1] << 10) + cube[:, 2]
    order = np.argsort(number, kind="stable")
    firsts = np.flatnonzero(np.diff(number[order], prepend=-1))
    return cells[order] & ((1 << level) - 1), np.append(firsts, len(cells))
