from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from workbench.cloud.chunk_codec import decode, encode_attribute, encode_positions
from workbench.cloud.schema import Attribute
from workbench.errors import InputError

RNG = np.random.default_rng(8)
POSITION = Attribute("points", "float64", 3)


def same_bits(a: np.ndarray, b: np.ndarray) -> bool:
    return a.dtype == b.dtype and a.shape == b.shape and a.tobytes() == b.tobytes()


def check_positions(points: np.ndarray) -> int:
    encoded = encode_positions(points, 1)
    assert np.array_equal(np.sort(encoded.order), np.arange(len(points)))
    assert same_bits(decode(encoded.value, POSITION, "x"), points[encoded.order])
    return len(encoded.value)


@given(
    hnp.arrays(
        np.float64,
        st.tuples(st.integers(1, 60), st.just(3)),
        elements=st.one_of(
            st.floats(-1e150, 1e150, allow_nan=False),
            st.sampled_from([0.0, -0.0, 5e-324, -5e-324, 1e-310, 5e5, 5.2e6, 1e-7]),
        ),
    )
)
@settings(max_examples=100, deadline=None)
def test_any_positions_come_back_with_every_bit(points: np.ndarray):
    check_positions(points)


@pytest.mark.parametrize("scale", [1e-9, 1.0, 1e9])
@pytest.mark.parametrize("offset", [(0, 0, 0), (5e5, 5.2e6, 100.0), (-3, 1e-3, 1e12)])
def test_positions_anywhere_come_back_with_every_bit(scale: float, offset: tuple):
    check_positions(scale * RNG.normal(size=(3000, 3)) + offset)


def test_positions_cost_little_more_than_their_information():
    n = 30_000
    points = RNG.integers(0, 1 << 50, (n, 3)) * 2.0**-50 + 1.0
    # Unordered points: log2(n!) bits of the 150 n need not be kept.
    information = (150 * n - (n * np.log2(n) - n * np.log2(np.e))) / 8
    assert information < check_positions(points) < 1.05 * information


def test_points_of_one_place_cost_nothing():
    assert check_positions(np.full((30_000, 3), 0.1)) < 300


@given(
    st.sampled_from(["u1", "i2", "u4", "i8", "f2", "f4", "f8"]),
    st.integers(1, 4),
    st.integers(1, 50),
    st.randoms(use_true_random=False),
)
@settings(max_examples=100, deadline=None)
def test_any_attribute_comes_back_with_every_bit(dtype, components, n, random):
    size = np.dtype(dtype).itemsize * components
    array = np.frombuffer(random.randbytes(n * size), dtype).reshape(n, components)
    attribute = Attribute("a", np.dtype(dtype).name, components)
    array = array.reshape(attribute.shape(n)).copy()
    assert same_bits(decode(encode_attribute(array, 1), attribute, "x"), array)


def test_unit_normals_cost_less_than_eight_bytes():
    normals = RNG.normal(size=(20_000, 3))
    normals = (normals / np.linalg.norm(normals, axis=1)[:, None]).astype(np.float32)
    value = encode_attribute(normals, 1)
    assert same_bits(decode(value, Attribute("n", "float32", 3), "x"), normals)
    assert len(value) / 20_000 < 7.5


def test_smooth_values_are_kept_as_steps():
    ramp = np.cumsum(RNG.integers(-2, 3, 20_000)).astype(np.int32)
    assert len(encode_attribute(ramp, 1)) / 20_000 < 0.5


@pytest.mark.parametrize("place", [0, 5, 12, 90, -1])
def test_a_flipped_byte_is_found(place: int):
    value = bytearray(encode_positions(RNG.random((500, 3)), 1).value)
    value[place] ^= 0x10
    with pytest.raises(InputError, match="damaged") as caught:
        decode(bytes(value), POSITION, "cloud.lmdb (chunk 3)")
    assert caught.value.file == "cloud.lmdb (chunk 3)"


@pytest.mark.parametrize("length", [0, 5, 11, 200])
def test_a_cut_value_is_found(length: int):
    value = encode_positions(RNG.random((500, 3)), 1).value
    with pytest.raises(InputError, match="damaged"):
        decode(value[:length], POSITION, "x")
