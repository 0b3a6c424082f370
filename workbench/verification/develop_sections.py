"""What a report shows of development: colours against the chart, exposure, linearity."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from workbench.color.chart import COLS, ROWS
from workbench.color.spaces import working_space, xyz_d50_from_lab
from workbench.formats.linear_tiff import LinearPicture
from workbench.render.palette import srgb_from_linear
from workbench.verification.report_content import (
    Block,
    Column,
    Paragraph,
    Picture,
    PictureRow,
    Plot,
    Section,
    Table,
    TextList,
)
from workbench.verification.svg import INK, inline_svg, page_style

_CELL_PX, _GAP_PX = 72, 8
_BOARD_COLOR = (38, 37, 36)
_CHART_SIDE_PX = COLS * _CELL_PX + _GAP_PX
_WIDTH_INCHES = 4.5
_MEASURED_COLOR, _FIT_COLOR = "#2f7f79", "#c8791a"


def development_section(
    inventory: Mapping[str, Any],
    calibration: Mapping[str, Any],
    chart_picture: LinearPicture | None = None,
) -> Section:
    """The chapter on development.

    Parameters
    ----------
    inventory, calibration : as the stage ``develop`` leaves them.
    chart_picture : the developed photograph of the chart, where it is one of the photographs.
    """
    blocks: list[Block] = [Paragraph(_colors_in_words(calibration))]
    if calibration["calibrated"]:
        blocks.append(_chart_row(calibration, chart_picture, inventory["pixel_step"]))
        blocks.append(_patch_table(calibration))
    blocks.append(_exposure_table(inventory["photos"]))
    odd = _odd_photographs(inventory["photos"])
    if odd:
        blocks.append(TextList(tuple(odd), tone="attention"))
    blocks.append(Paragraph(_light_in_words(calibration)))
    if calibration["linearity"]:
        blocks.append(_linearity_plot(calibration["linearity"]))
    intro = "How the photographs’ numbers were turned into light and colour."
    return Section("Colour and exposure", intro, tuple(blocks))


def _colors_in_words(calibration: Mapping[str, Any]) -> str:
    if not calibration["calibrated"]:
        return (
            f"Not colour calibrated: {calibration['reason']}. Colours are those of the camera’s "
            "white balance and its maker’s matrix, or of the files’ profiles; do not measure them."
        )
    kind = {"linear": "3 × 3 matrix", "root_polynomial": "root-polynomial matrix of degree 2"}
    checks = calibration["checks"]
    checked = "".join(
        f" On {name}, which was not fitted, it is {check['mean_delta_e2000']:.2f}."
        for name, check in checks.items()
    )
    edition = {"after_2014": "since November 2014", "before_2014": "before November 2014"}
    return (
        f"Colour calibrated with the ColorChecker in {calibration['chart']}: white balance and a "
        f"{kind[calibration['kind']]} to {working_space(calibration['space']).title}. The mean "
        f"difference from the maker’s colours (charts made {edition[calibration['edition']]}) is "
        f"ΔE2000 {calibration['mean_delta_e2000']:.2f}, the largest "
        f"{calibration['worst_delta_e2000']:.2f}; of patches left out of the fit, each in turn, "
        f"{calibration['left_out_mean_delta_e2000']:.2f}.{checked} 1 is about what a practised "
        f"eye can see. A slope of light across the chart, {_slope(calibration['shading'])}, was "
        "taken out."
    )


def _slope(shading: Sequence[float]) -> str:
    across, down = (100.0 * (np.exp(2.0 * value) - 1.0) for value in shading)
    return f"{across:+.0f} % over its width and {down:+.0f} % over as much downwards".replace(
        "-", "−"
    )


def _chart_row(
    calibration: Mapping[str, Any], chart_picture: LinearPicture | None, step: int
) -> PictureRow:
    pictures = [
        Picture(
            _swatches(calibration["patches"]),
            "measured round reference",
            "24 patches: the measured colour as a frame, the published one in its middle",
        )
    ]
    if chart_picture is not None:
        corners = np.array(calibration["corners_px"]) / step
        pictures.insert(
            0,
            Picture(
                _rectified(chart_picture, corners),
                "as developed",
                f"the chart in {calibration['chart']}, developed",
                is_photograph=True,
            ),
        )
    caption = (
        "The chart as developed, and each measured colour as a frame round the one that the maker "
        "publishes: the less the inner square shows, the better. What lies outside a screen’s "
        "colours is shown at their border."
    )
    return PictureRow(tuple(pictures), caption, most_beside=2)


def _swatches(patches: Sequence[Mapping[str, Any]]) -> NDArray[np.uint8]:
    """The chart drawn: measured colours, the published ones in their middles."""
    picture = np.empty((ROWS * _CELL_PX + _GAP_PX, COLS * _CELL_PX + _GAP_PX, 3), np.uint8)
    picture[:] = _BOARD_COLOR
    measured = _shown([patch["measured_lab"] for patch in patches])
    reference = _shown([patch["reference_lab"] for patch in patches])
    inset = (_CELL_PX - _GAP_PX) // 4
    for k in range(len(patches)):
        top, left = (_GAP_PX + _CELL_PX * place for place in divmod(k, COLS))
        bottom, right = top + _CELL_PX - _GAP_PX, left + _CELL_PX - _GAP_PX
        picture[top:bottom, left:right] = measured[k]
        picture[top + inset : bottom - inset, left + inset : right - inset] = reference[k]
    return picture


def _shown(lab: Sequence[Sequence[float]]) -> NDArray[np.uint8]:
    """Colours (n, 3) as sRGB."""
    to_rgb = working_space("rec709").rgb_from_xyz_d50
    linear = xyz_d50_from_lab(np.array(lab, float)) @ to_rgb.T
    return srgb_from_linear(np.clip(linear, 0.0, 1.0).astype(np.float32))


def _rectified(picture: LinearPicture, corners: NDArray[np.float64]) -> NDArray[np.uint8]:
    """The chart seen squarely, (h, w, 3) uint8 sRGB."""
    width, height = _CHART_SIDE_PX, ROWS * _CELL_PX + _GAP_PX
    target = np.array([[0, 0], [width, 0], [width, height], [0, height]], np.float32)
    seen = cv2.getPerspectiveTransform(target, corners.astype(np.float32))
    flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
    flat = cv2.warpPerspective(picture.values, seen, (width, height), flags=flags)
    space = working_space("prophoto" if picture.space == "prophoto" else "rec709")
    to_shown = working_space("rec709").rgb_from_xyz_d50 @ space.xyz_d50_from_rgb
    linear = np.asarray(flat, np.float64) @ to_shown.T
    return srgb_from_linear(np.clip(linear, 0.0, 1.0).astype(np.float32))


def _patch_table(calibration: Mapping[str, Any]) -> Table:
    columns = (
        Column("Patch"),
        Column("ΔE2000", decimals=2),
        Column("ΔE2000, left out of the fit", decimals=2),
        Column("L*", decimals=1),
        Column("a*", decimals=1),
        Column("b*", decimals=1),
    )
    rows = tuple(
        (
            patch["name"] if patch["fitted"] else f"{patch['name']} (clipped, not fitted)",
            patch["delta_e2000"],
            patch["left_out_delta_e2000"],
            *patch["measured_lab"],
        )
        for patch in calibration["patches"]
    )
    caption = "Colour differences from the maker’s data, patch by patch, and the measured CIE Lab."
    return Table(columns, rows, caption)


def _exposure_table(photos: Sequence[Mapping[str, Any]]) -> Table:
    groups = Counter(
        (photo["camera"], photo["lens"], _settings(photo), photo["gain"]) for photo in photos
    )
    columns = (
        Column("Photographs", decimals=0),
        Column("Settings"),
        Column("Gain", "stops", 2),
        Column("Camera and lens", style="wide"),
    )
    rows = tuple(
        (count, settings, float(np.log2(gain)), ", ".join(filter(None, (camera, lens))) or None)
        for (camera, lens, settings, gain), count in groups.most_common()
    )
    caption = (
        "Settings as the files tell them, and what brought the photographs to one exposure: by "
        "ISO and aperture where the flash lit them, by time as well where it did not."
    )
    return Table(columns, rows, caption)


def _settings(photo: Mapping[str, Any]) -> str:
    """Focal length, exposure and flash in a photographer's notation."""
    time, fired = photo["exposure_time_s"], photo["flash_fired"]
    told = [
        f"{photo['focal_length_mm']:.3g} mm" if photo["focal_length_mm"] else None,
        None if not time else (f"1/{1 / time:.0f} s" if time < 0.4 else f"{time:.3g} s"),
        f"f/{photo['f_number']:.3g}" if photo["f_number"] else None,
        f"ISO {photo['iso']:.0f}" if photo["iso"] else None,
        None if fired is None else ("flash" if fired else "no flash"),
    ]
    return ", ".join(part for part in told if part) or "not told"


def _odd_photographs(photos: Sequence[Mapping[str, Any]]) -> list[str]:
    told = []
    for photo in photos:
        parts = [photo["odd_settings"]] if photo["odd_settings"] else []
        if photo["odd_brightness_stops"] is not None:
            stops = photo["odd_brightness_stops"]
            way = "brighter" if stops > 0 else "darker"
            parts.append(f"{abs(stops):.1f} stops {way} than the others")
        if parts:
            told.append(f"{photo['name']}: {'; '.join(parts)}")
    return told


def _light_in_words(calibration: Mapping[str, Any]) -> str:
    vignetting = calibration["vignetting"]
    if vignetting:
        corner = 100.0 * (1.0 + sum(vignetting["coefficients"]))
        light = (
            f"The lens brings {corner:.0f} % of the light to the corners; that was evened out "
            f"from a flat frame, of which {100.0 * vignetting['residual']:.2g} % RMS is left "
            "unexplained."
        )
    else:
        light = f"Vignetting was not evened out: {calibration['no_vignetting']}."
    if calibration["linearity"]:
        return light
    return f"{light} The sensor’s linearity was not checked: {calibration['no_linearity']}."


def _linearity_plot(linearity: Mapping[str, Any]) -> Plot:
    """Levels against 1/d², as in fig. 3.8 of Jaspe 2018."""
    from matplotlib.figure import Figure

    distances, levels = (np.array(linearity[name], float) for name in ("distances", "levels"))
    inverse = 1.0 / distances**2
    line = np.array([0.0, 1.05 * inverse.max()])
    with page_style():
        figure = Figure(figsize=(_WIDTH_INCHES, 2.9), layout="constrained")
        axes = figure.add_subplot()
        axes.plot(line, linearity["factor"] * line, color=_FIT_COLOR, lw=1.4, label="c / d²")
        axes.plot(inverse, levels, "o", color=_MEASURED_COLOR, ms=5, label="measured")
        axes.set_xlim(0.0, line[1])
        axes.set_ylim(0.0, None)
        unit = "1/d² (1/m²)" if linearity["metric"] else "1/d², nearest = 1"
        axes.set_xlabel(unit)
        axes.set_ylabel("Level (1 = sensor full)")
        axes.legend(loc="upper left", labelcolor=INK)
    alt = "Levels of a white surface against the inverse square of its distance, with the fit"
    residual, worst = (100.0 * linearity[name] for name in ("residual", "worst"))
    caption = (
        f"Sensor linearity: a white surface at {len(levels)} distances. The levels are "
        f"proportional to 1/d² to {residual:.1f} % RMS, {worst:.1f} % at worst; the power that "
        f"fits best is {linearity['exponent']:.3f}".replace("-", "−")
        + (
            ". (Jaspe 2018, fig. 3.8.)"
            if linearity["metric"]
            else ". Distances are those that the chart’s size tells. (Jaspe 2018, fig. 3.8.)"
        )
    )
    data = {name: linearity[name] for name in ("names", "distances", "levels", "residual")}
    return Plot(inline_svg(figure, "linearity", alt), caption, data)
