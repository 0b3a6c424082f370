from __future__ import annotations

import doctest
import re
import xml.etree.ElementTree as ET

import numpy as np
import pytest

import workbench.verification.quantities
from workbench.render.palette import ColorScale
from workbench.verification.figures import (
    TradeoffPoint,
    bar_figure,
    color_bar_figure,
    histogram_figure,
    overlap_figure,
    pareto_front,
    tradeoff_figure,
)
from workbench.verification.quantities import shown_bytes, shown_number


def texts(svg: str) -> list[str]:
    """The words a reader sees; fails when the drawing is not well-formed XML."""
    return ["".join(node.itertext()).strip() for node in ET.fromstring(svg).iter() if is_text(node)]


def is_text(node: ET.Element) -> bool:
    return node.tag.endswith("}text")


@pytest.fixture
def histogram(rng) -> str:
    before, after = np.abs(rng.normal(size=(2, 3000)))
    series = {"before $x$ <b>": before, "after": 0.01 * after}
    return histogram_figure("h", series, "Distance (mm)", 'A "figure" & more')


def test_labels_stay_text_as_they_were_written(histogram):
    words = texts(histogram)
    assert "Distance (mm)" in words
    assert "Share of samples (%)" in words
    assert any(word.startswith("before $x$ <b>: median") for word in words)


def test_medians_far_apart_make_a_logarithmic_axis_with_plain_numbers(histogram):
    assert {"0.01", "0.1", "1"} <= set(texts(histogram))


def test_the_medians_are_told(rng):
    values = np.linspace(0, 2, 2001)
    svg = histogram_figure("h", {"samples": values}, "x", "alt")
    assert "samples: median 1" in texts(svg)


def test_figures_take_the_colours_and_fonts_of_the_page(histogram):
    assert "var(--ink)" in histogram
    assert "var(--sans)" in histogram
    assert "DejaVu" not in histogram
    assert "#23211d" not in histogram


def test_ids_of_two_figures_do_not_meet(rng):
    values = rng.random(100)
    ids = [
        set(re.findall(r'\bid="([^"]+)"', histogram_figure(name, {"v": values}, "x", "alt")))
        for name in ("first", "second")
    ]
    assert ids[0]
    assert not ids[0] & ids[1]


def test_references_inside_a_figure_find_their_target(histogram):
    ids = set(re.findall(r'\bid="([^"]+)"', histogram))
    targets = re.findall(r'url\(#([^)]+)\)|href="#([^"]+)"', histogram)
    assert targets
    assert {a or b for a, b in targets} <= ids


def test_the_same_figure_is_the_same_text(rng):
    shares = rng.random((4, 4))
    first, second = (overlap_figure("o", list("abcd"), shares, "alt") for _ in range(2))
    assert first == second
    assert "date" not in first.lower()


def test_overlap_cells_tell_per_cent_and_leave_the_diagonal_empty():
    words = texts(overlap_figure("o", ["a", "b"], [[1, 0.42], [0.17, 1]], "alt"))
    assert "42" in words
    assert "17" in words
    assert words.count("100") == 1  # the colour bar's end


def test_bars_write_their_values_and_leave_out_missing_ones():
    svg = bar_figure(
        "b", ["fuse", "infill"], [("Peak memory", [2.5e9, float("nan")], shown_bytes)], "alt"
    )
    words = texts(svg)
    assert {"fuse", "infill", "2.5 GB"} <= set(words)
    assert not any("nan" in word.lower() for word in words)


def test_the_front_is_what_nothing_beats():
    x, y = [1, 2, 3, 4, 2, 1], [5, 3, 4, 1, 3.5, 6]
    assert [(x[k], y[k]) for k in pareto_front(x, y)] == [(1, 5), (2, 3), (4, 1)]


def test_a_tradeoff_names_the_front_and_the_default():
    points = [
        TradeoffPoint("quick", 1, 0.9),
        TradeoffPoint("poor", 2, 1.5),
        TradeoffPoint("standard", 4, 0.2),
        TradeoffPoint("fine", 60, 0.1),
    ]
    words = texts(tradeoff_figure(points, "Time (s)", "Error (mm)", "standard"))
    assert {"quick", "standard", "fine", "Time (s)", "Error (mm)"} <= set(words)
    assert "default: standard" in words
    assert "poor" not in words


def test_a_colour_bar_tells_its_quantity():
    words = texts(color_bar_figure("c", ColorScale.diverging(0.2, "Deviation (mm)"), "alt"))
    assert "Deviation (mm)" in words
    assert "0.2" in words
    assert "−0.2" in words


def test_quantities_doctests_hold():
    assert doctest.testmod(workbench.verification.quantities).failed == 0


def test_numbers_have_true_minus_signs_and_no_needless_zeros():
    assert shown_number(-1234.5) == "−1\u202f234" or shown_number(-1234.5) == "−1\u202f235"
    assert shown_number(-0.5) == "−0.5"
    assert shown_number(0.0) == "0"
    assert shown_number(1000.0) == "1\u202f000"
