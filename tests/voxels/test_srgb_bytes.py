import numpy as np

from workbench.kernels.srgb_bytes import LINEAR_OF_BYTE, srgb_byte


def test_bytes_are_those_of_the_formula_and_come_back():
    rng = np.random.default_rng(0)
    linear = np.concatenate([rng.uniform(-0.1, 1.1, 3000), 10 ** rng.uniform(-9, 0, 3000)])
    clipped = np.clip(linear, 0, 1)
    encoded = np.where(clipped <= 0.0031308, 12.92 * clipped, 1.055 * clipped ** (1 / 2.4) - 0.055)

    found = np.array([srgb_byte(value) for value in linear])

    # The two halves of the standard do not meet to the last digit: a tie may go either way.
    assert np.abs(255 * encoded - found).max() < 0.5 + 1e-4
    assert [srgb_byte(value) for value in LINEAR_OF_BYTE] == list(range(256))
