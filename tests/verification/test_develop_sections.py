"""What a report says of development."""

from __future__ import annotations

from typing import Any

import numpy as np

from workbench.color.calibration import calibrated, described
from workbench.color.chart import patch_middles, reference_xyz_d50
from workbench.color.patches import ChartPatches
from workbench.color.spaces import working_space
from workbench.formats.linear_tiff import LinearPicture
from workbench.verification.develop_sections import development_section
from workbench.verification.report_content import (
    Paragraph,
    PictureRow,
    Plot,
    Section,
    Table,
    TextList,
)

SPACE = working_space("rec709")


def _photo(name: str, **changes: Any) -> dict[str, Any]:
    told = {
        "name": name,
        "camera": "House One",
        "lens": None,
        "focal_length_mm": 50.0,
        "exposure_time_s": 1 / 250,
        "f_number": 11.0,
        "iso": 200.0,
        "flash_fired": True,
        "gain": 1.0,
        "odd_settings": None,
        "odd_brightness_stops": None,
    }
    return told | changes


def _inventory(*photos: dict[str, Any]) -> dict[str, Any]:
    return {"photos": list(photos), "pixel_step": 1, "space": "rec709", "scale": 2.0}


UNCALIBRATED: dict[str, Any] = {
    "calibrated": False,
    "reason": "no chart was found in 12 photographs",
    "space": "rec709",
    "vignetting": None,
    "no_vignetting": "there is no flat frame",
    "linearity": None,
    "no_linearity": "2 frames at known distances; 3 are needed",
}


def _calibrated() -> dict[str, Any]:
    seen = reference_xyz_d50("after_2014") * [0.7, 0.8, 0.5]
    seen[14] *= [1.2, 1.0, 1.0]
    patches = ChartPatches(seen, np.full(24, 1e-3), np.zeros(24), 10 * patch_middles())
    found = calibrated(patches, SPACE)
    return UNCALIBRATED | {
        "calibrated": True,
        "chart": "chart_00",
        "corners_px": [[10.0, 10.0], [130.0, 10.0], [130.0, 90.0], [10.0, 90.0]],
        "edition": found.edition,
        **found.color.as_dict(),
        "shading": [0.05, -0.02],
        "patches": described(found),
        "mean_delta_e2000": found.mean,
        "worst_delta_e2000": found.worst,
        "left_out_mean_delta_e2000": found.left_out_mean,
        "checks": {"chart_01": {"mean_delta_e2000": 0.77, "worst_delta_e2000": 2.0}},
        "vignetting": {"coefficients": [-0.3, 0.0, 0.0], "residual": 0.001},
        "linearity": {
            "names": ["a", "b", "c"],
            "distances": [1.0, 2.0, 3.0],
            "metric": True,
            "levels": [0.9, 0.225, 0.1],
            "factor": 0.9,
            "residual": 0.004,
            "worst": 0.006,
            "exponent": -2.01,
        },
    }


def _of(section: Section, kind: type) -> list[Any]:
    return [block for block in section.blocks if isinstance(block, kind)]


def test_without_a_chart_the_words_are_plain() -> None:
    section = development_section(_inventory(_photo("a")), UNCALIBRATED)
    words = " ".join(paragraph.text for paragraph in _of(section, Paragraph))
    assert "Not colour calibrated: no chart was found in 12 photographs." in words
    assert "Vignetting was not evened out: there is no flat frame." in words
    assert "linearity was not checked: 2 frames" in words
    assert not _of(section, PictureRow)


def test_with_a_chart_every_patch_has_its_row() -> None:
    told = _calibrated()
    section = development_section(_inventory(_photo("chart_00")), told)
    patches, exposures = _of(section, Table)
    assert len(patches.rows) == 24
    assert max(row[1] for row in patches.rows) == told["worst_delta_e2000"]
    assert len(exposures.rows) == 1
    words = _of(section, Paragraph)[0].text
    assert f"ΔE2000 {told['mean_delta_e2000']:.2f}" in words
    assert "On chart_01, which was not fitted, it is 0.77." in words
    (plot,) = _of(section, Plot)
    assert "<svg" in plot.svg
    assert "−2.010" in plot.caption


def test_measured_colours_frame_the_published_ones() -> None:
    told = _calibrated()
    section = development_section(_inventory(_photo("chart_00")), told)
    (row,) = _of(section, PictureRow)
    (drawn,) = row.pictures
    worst = int(np.argmax([patch["delta_e2000"] for patch in told["patches"]]))
    down, right = divmod(worst, 6)
    top, left = 8 + 72 * down, 8 + 72 * right
    frame, middle = drawn.pixels[top + 2, left + 2], drawn.pixels[top + 32, left + 32]
    assert np.abs(frame.astype(int) - middle).max() >= 5
    white = drawn.pixels[8 + 72 * 3 + 32, 8 + 32].astype(int)
    assert white.min() > 230
    assert np.ptp(white) < 15


def test_the_developed_chart_is_shown_squarely() -> None:
    values = np.zeros((100, 140, 3), np.float32)
    values[10:90, 10:130] = [0.4, 0.2, 0.1]
    picture = LinearPicture(values, "rec709", 2.0, b"")
    section = development_section(_inventory(_photo("chart_00")), _calibrated(), picture)
    (row,) = _of(section, PictureRow)
    developed = row.pictures[0].pixels
    expected = [170, 124, 89]  # sRGB of 0.4, 0.2, 0.1
    assert np.abs(developed[20:-20, 20:-20].astype(int) - expected).max() <= 1


def test_photographs_of_other_settings_are_grouped_and_odd_ones_named() -> None:
    photos = [_photo(f"p{k}") for k in range(5)]
    photos.append(
        _photo(
            "q", iso=400.0, gain=0.5, odd_settings="ISO 400 (most: 200)", odd_brightness_stops=-2.0
        )
    )
    section = development_section(_inventory(*photos), UNCALIBRATED)
    (exposures,) = _of(section, Table)
    assert exposures.rows[0] == (5, "50 mm, 1/250 s, f/11, ISO 200, flash", 0.0, "House One")
    assert exposures.rows[1][2] == -1.0
    (odd,) = _of(section, TextList)
    assert odd.items == ("q: ISO 400 (most: 200); 2.0 stops darker than the others",)
    assert odd.tone == "attention"
