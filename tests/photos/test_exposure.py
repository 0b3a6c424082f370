"""Exposures brought together, and photographs that do not belong."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from workbench.photos.exif import PhotoFacts
from workbench.photos.exposure import (
    bright_level,
    compared_exposures,
    odd_brightness,
    odd_settings,
)

LIT = PhotoFacts(camera="C", exposure_time_s=1 / 100, f_number=8.0, iso=100.0, flash_fired=False)


def test_gains_undo_time_iso_and_aperture() -> None:
    photos = {
        "a": LIT,
        "b": replace(LIT, exposure_time_s=1 / 200),
        "c": replace(LIT, iso=400.0),
        "d": replace(LIT, f_number=4.0),
        "e": LIT,
    }
    found = compared_exposures(photos)
    assert found.differ
    assert found.gains["a"] == found.gains["e"] == 1.0
    assert found.gains["b"] == pytest.approx(2.0)
    assert found.gains["c"] == pytest.approx(0.25)
    assert found.gains["d"] == pytest.approx(0.25)


def test_the_reference_is_the_one_that_is_named() -> None:
    photos = {"a": LIT, "b": LIT, "chart": replace(LIT, iso=200.0)}
    found = compared_exposures(photos, "chart")
    assert found.gains["chart"] == 1.0
    assert found.gains["a"] == pytest.approx(2.0)


def test_a_flash_is_over_before_the_shutter_closes() -> None:
    lit = replace(LIT, flash_fired=True)
    found = compared_exposures({"a": lit, "b": replace(lit, exposure_time_s=1 / 25)})
    assert found.gains == {"a": 1.0, "b": 1.0}
    stopped = compared_exposures({"a": lit, "b": lit, "c": replace(lit, f_number=16.0)})
    assert stopped.gains["c"] == pytest.approx(4.0)


def test_engraved_numbers_are_rounded() -> None:
    found = compared_exposures({"a": replace(LIT, f_number=5.6), "b": replace(LIT, f_number=5.657)})
    assert not found.differ
    assert set(found.gains.values()) == {1.0}


def test_what_is_not_told_is_named_and_left() -> None:
    found = compared_exposures({"a": LIT, "b": PhotoFacts()})
    assert found.unknown == ("b",)
    assert found.gains["b"] == 1.0
    assert compared_exposures({"b": PhotoFacts()}).gains == {"b": 1.0}


def test_other_settings_are_told_of_the_one_that_has_them() -> None:
    photos = {f"p{k}": replace(LIT, flash_fired=True, lens="A") for k in range(6)}
    photos["p3"] = replace(photos["p3"], flash_fired=False, iso=200.0)
    assert odd_settings(photos) == {"p3": "ISO 200 (most: 100); flash did not fire (most: fired)"}
    photos["p3"] = photos["p0"]
    assert odd_settings(photos) == {}


def test_the_dark_photograph_is_named_and_no_other() -> None:
    rng = np.random.default_rng(0)
    levels = {f"p{k}": float(0.3 * np.exp(0.1 * rng.standard_normal())) for k in range(20)}
    assert odd_brightness(levels) == {}
    levels["p7"] *= 0.1
    found = odd_brightness(levels)
    assert list(found) == ["p7"]
    assert found["p7"] == pytest.approx(-np.log2(10), abs=0.5)


def test_a_set_that_varies_has_no_outliers() -> None:
    levels = {f"p{k}": 0.02 * 1.5**k for k in range(10)}
    assert odd_brightness(levels) == {}


def test_brightness_is_of_what_is_lit() -> None:
    """The same surface in a dark room, once larger in the frame."""
    small, large = np.zeros((100, 100, 3), np.float32), np.zeros((100, 100, 3), np.float32)
    small[:35, :35] = large[:80, :80] = 0.4
    assert bright_level(small) == pytest.approx(bright_level(large), rel=0.01)
