import numpy as np
import pytest

from workbench.kernels.morton import morton_cells, morton_codes


def test_codes_weave_the_bits_of_three_coordinates_and_come_back():
    cells = np.random.default_rng(0).integers(0, 1 << 21, (300, 3))
    cells[0], cells[1] = 0, (1 << 21) - 1

    codes = morton_codes(cells)

    for cell, code in zip(cells.tolist(), codes.tolist(), strict=True):
        woven = sum((cell[a] >> b & 1) << (3 * b + a) for a in range(3) for b in range(21))
        assert code == woven
    np.testing.assert_array_equal(morton_cells(codes), cells)


@pytest.mark.parametrize("cell", [[-1, 0, 0], [0, 1 << 21, 0]])
def test_cells_that_no_code_holds_are_refused(cell):
    with pytest.raises(ValueError, match="outside"):
        morton_codes(np.array([cell]))
