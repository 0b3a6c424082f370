"""Extended cell identification: the paper's bits, nothing lost, and what is refused."""

from __future__ import annotations

import numpy as np
import pytest

from tests.pointcodecs.cubes import FIGURE, all_positions, by_cube, isolated, random_cubes, shell
from workbench.errors import InputError
from workbench.kernels.point_layers import encode_layers, room_for_layers
from workbench.pointcodecs.codecs import CODECS

ECI = CODECS["eci"]
# Figure 3 (b), of the positions 0…26 but that of the seed, 7.
FIGURE_3 = [
    "000", "0010", "0100", "01010", "1000", "10010", "10100", "0011", "01011", "10011",
    "101011", "0110", "01110", "10110", "101110", "01111", "101111", "1100", "11010", "11100",
    "111010", "11110", "111110", "11011", "111011", "111111",
]  # fmt: skip
_STEPS = {"0": -1, "10": 0, "11": 1}


def bits_of(points: np.ndarray, level: int) -> tuple[str, np.ndarray]:
    """Bits of one cube that begins at its first point, and its points in their order."""
    starts, order = np.array([0, len(points)]), np.empty(len(points), np.int64)
    data, ends = np.zeros(room_for_layers(len(points), 1, level) + 3, np.uint8), np.zeros(1, int)
    encode_layers(np.asarray(points, np.int32), starts, level, data, ends, order)
    return "".join(f"{byte:08b}" for byte in data[: ends[0]]), points[order]


class PlainDecoder:
    """Figure 5 (b), line by line, on a string of bits; it notes the records it reads."""

    def __init__(self, bits: str, level: int) -> None:
        self.bits, self.level, self.records = bits, level, []

    def number(self, width: int) -> int:
        taken, self.bits = self.bits[:width], self.bits[width:]
        assert len(taken) == width
        return int(taken or "0", 2)

    def offset(self) -> tuple[int, int, int]:
        steps = []
        for _ in range(3):
            width = 1 if self.bits[0] == "0" else 2
            steps.append(_STEPS[self.bits[:width]])
            self.bits = self.bits[width:]
        return tuple(steps)

    def seed(self, point: tuple[int, ...]) -> tuple[tuple[int, ...], int, int]:
        reached = self.number(5)
        width = 0 if reached == 0 else max(1, int(np.ceil(np.log2(reached))))
        return point, reached, self.number(width)

    def points(self) -> list[tuple[int, ...]]:
        found = []
        while self.number(1):
            first = tuple(self.number(self.level) for _ in range(3))
            found.append(first)
            seeds = [self.seed(first)]
            self.records.append(seeds)
            while seeds:
                following = []
                for point, reached, count in seeds:
                    for i in range(reached):
                        place = tuple(np.add(point, self.offset()).tolist())
                        found.append(place)
                        if i < count:
                            following.append(self.seed(place))
                seeds = following
                self.records.append(seeds)
        return found


def test_the_cube_of_figure_1_becomes_the_bits_of_figure_4():
    bits, points = bits_of(FIGURE, 2)

    # The order of layer 2 in section 2.2: positions 3, 5, 2, 4, 1 of cell 0.
    np.testing.assert_array_equal(points[:6] @ [4, 2, 1], [0, 3, 5, 2, 4, 1])
    # Behind the place of the first point, which figure 4 leaves out: (5, 2), then
    # (101111, 8, 2), (111011, 5, 1) and (101110) and two more without ψ; layer 3 begins with
    # (101111, 6, 1).
    start = "1" + "000000" + "00101" + "010"
    layer_2 = "101111" + "01000" + "010" + "111011" + "00101" + "001" + "101110"
    assert bits.startswith(start + layer_2 + "111010" + "101011" + "101111" + "00110" + "001")


def test_offsets_have_the_codes_of_figure_3():
    around = all_positions(2)[(all_positions(2) < 3).all(axis=1)]
    middle = (around == 1).all(axis=1)
    bits, points = bits_of(np.concatenate([around[middle], around[~middle]]), 2)

    plain = PlainDecoder(bits, 2)
    assert plain.points() == [tuple(point) for point in points.tolist()]
    # ψ of 26 and no seeds, in 5 and 5 bits; then the table in some order, a bit 0, padding.
    assert bits.startswith("1" + "010101" + "11010" + "00000")
    codes = sorted(FIGURE_3)
    assert len(bits.rstrip("0")) <= 17 + sum(map(len, codes)) <= len(bits)
    decoder = PlainDecoder(bits[17:], 2)
    found = []
    for _ in range(26):
        before = decoder.bits
        decoder.offset()
        found.append(before[: len(before) - len(decoder.bits)])
    assert sorted(found) == codes


@pytest.mark.parametrize("level", [2, 3, 5])
def test_a_decoder_made_of_the_papers_lines_reads_the_same(level):
    points, starts = random_cubes(30, level, 60 if level < 5 else 700, seed=level)
    coded = ECI.encoded(points, starts, level)
    back = ECI.decoded(coded.data, coded.bytes_at, starts, level)

    for k in range(len(starts) - 1):
        part = coded.data[coded.bytes_at[k] : coded.bytes_at[k + 1]]
        plain = PlainDecoder("".join(f"{byte:08b}" for byte in part), level)
        expected = np.array(plain.points(), np.int32).reshape(-1, 3)
        np.testing.assert_array_equal(back[starts[k] : starts[k + 1]], expected)
        assert set(plain.bits) <= {"0"}
        assert len(plain.bits) < 8


def test_layers_are_steps_from_the_first_point_and_larger_seeds_come_first():
    points, starts = by_cube(shell(5, thick=True), 5)
    assert len(starts) == 2
    coded = ECI.encoded(points, starts, 5)
    plain = PlainDecoder("".join(f"{byte:08b}" for byte in coded.data), 5)
    plain.points()

    reach = [[seed[1] for seed in layer] for layer in plain.records]
    # The whole surface is one piece that no seed ran out of bits for.
    assert sum(map(sum, reach)) + 1 == len(points)
    first = np.array(plain.records[0][0][0])
    assert (first == points[points.sum(axis=1).argmax()]).all()
    for number, layer in enumerate(plain.records):
        for place, reached, _ in layer:
            assert np.abs(np.subtract(place, first)).max() <= number
            assert 1 <= reached <= 26


def test_nothing_is_lost_in_ten_thousand_random_cubes():
    points, starts = random_cubes(10_000, 5, 400, seed=2)

    coded = ECI.encoded(points, starts, 5)
    back = ECI.decoded(coded.data, coded.bytes_at, starts, 5)

    np.testing.assert_array_equal(back, points[coded.order])
    assert len(np.unique(coded.order)) == len(points)


@pytest.mark.parametrize(
    ("points", "bits"),
    [
        # A bit, 15 for the place, ψ = 0; and the 0 after the last.
        (all_positions(5)[-1:], 1 + 15 + 5 + 1),
        (isolated(5), 4096 * (1 + 15 + 5) + 1),
        (all_positions(5)[:0], 1),
    ],
    ids=["one", "isolated", "empty"],
)
def test_points_without_neighbours_are_pieces_of_their_own(points, bits):
    coded = ECI.encoded(points, np.array([0, len(points)]), 5)

    assert len(coded.data) == -(-bits // 8)


def test_a_surface_costs_what_the_paper_says():
    bits = []
    for level in (5, 6, 7, 8):
        points, starts = by_cube(shell(level, thick=True), 5)
        coded = ECI.encoded(points, starts, 5)
        bits.append(8 * len(coded.data) / len(points))

    # Section 6: 7.7 on the average; 3 bits are the least a point can take.
    assert np.mean(bits) <= 7.7
    assert min(bits) > 3


def test_noise_is_refused_without_end():
    rng = np.random.default_rng(9)
    for size in rng.integers(1, 3000, 300):
        noise = rng.integers(0, 256, size).astype(np.uint8)
        with pytest.raises(InputError, match="damaged"):
            ECI.decoded(noise, np.array([0, size]), np.array([0, size]), 5)
