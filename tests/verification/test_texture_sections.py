"""What a report says and shows of texturing."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from tests.render.stitch.stitch_cases import labelled, pinhole, plain, wall
from workbench.verification.image_quality import ColorSteps
from workbench.verification.report_content import Paragraph, PictureRow, Table, TextList
from workbench.verification.texture_sections import texture_section
from workbench.verification.texture_views import (
    WAYS,
    HeldOutView,
    Quality,
    held_out_view,
    view_metrics,
)

METRICS: dict[str, Any] = {
    "photographs": 6,
    "held_out": 1,
    "used_pixels": 81.0,
    "doubted_pixels": 2.5,
    "depth_meshes": 6,
    "depth_triangles": 1200,
    "foreground_triangles": 480,
    "energy_before": 12.5,
    "energy": 9.25,
    "energy_gap": 0.5,
    "atlas_patches": 40,
    "atlas_pages": 1,
    "surface_unseen": 3.0,
}


def record(metrics: dict[str, Any] | None = None, **more: Any) -> dict[str, Any]:
    told = METRICS if metrics is None else metrics
    return {"metrics": [{"name": k, "value": v} for k, v in told.items()], **more}


def view(name: str = "p3", psnr: float = 30.0, ways=("stitched", "blended")) -> HeldOutView:
    mask = np.zeros((40, 60), bool)
    mask[10:20, 30:45] = True
    grey = np.full((40, 60, 3), 0.5, np.float32)
    labels = np.full((40, 60), -1, np.int32)
    labels[:, 35:] = 4
    return HeldOutView(
        name, grey, "the true albedo", mask, dict.fromkeys(ways, grey), labels,
        {way: Quality(psnr, 0.9, 0.002) for way in ways}, 0.004,
        ColorSteps(9.0, 2.0, 20), ColorSteps(3.0, 2.0, 20), {"visibility": 0.1},
    )  # fmt: skip


def said(section: Any) -> str:
    return " ".join(block.text for block in section.blocks if isinstance(block, Paragraph))


def test_the_chapter_tells_how_much_of_what_was_used():
    told = said(texture_section(record(), [], 480))
    for words in ("6 photographs", "81.0 %", "2.5 %", "1,200 triangles", "480 of them", "1 page;"):
        assert words in told.replace("\u202f", ",").replace("\u00a0", " "), words
    assert "texture.held_out" in told
    without = {k: v for k, v in METRICS.items() if not k.startswith(("depth", "atlas"))}
    told = said(texture_section(record(without), [], 0))
    assert "depth meshes" not in told
    assert "patches" not in told


def test_warnings_stand_in_the_chapter():
    section = texture_section(record(warnings=["no flash"]), [], 0)
    lists = [block for block in section.blocks if isinstance(block, TextList)]
    assert [block.items for block in lists] == [("no flash",)]


def test_the_table_has_the_means_of_all_views_and_sharpness_as_a_share():
    section = texture_section(record(), [view(psnr=30.0), view("p5", psnr=34.0)], 480)
    tables = [block for block in section.blocks if isinstance(block, Table)]
    rows = {row[0]: row[1:] for row in tables[0].rows}
    assert set(rows) == {WAYS["stitched"], WAYS["blended"]}
    assert rows[WAYS["stitched"]] == pytest.approx((32.0, 0.9, 50.0))
    assert "480" in tables[0].caption
    assert tables[1].rows == (("p3", 9.0, 3.0, 2.0), ("p5", 9.0, 3.0, 2.0))
    assert ("energy of the labels", 9.25) in tables[2].rows


def test_pictures_show_what_is_compared_cut_to_it_and_labels_in_colours():
    section = texture_section(record(), [view()], 480)
    row = next(block for block in section.blocks if isinstance(block, PictureRow))
    assert "p3" in row.caption
    assert next(p.caption for p in row.pictures) == "The true albedo"
    sizes = {picture.pixels.shape for picture in row.pictures}
    assert len(sizes) == 1
    assert next(iter(sizes))[0] < 40
    labels = row.pictures[-1].pixels
    own = labels[8:18, 8:23].reshape(-1, 3)
    # No photograph, and one: two colours, and grey is the first's.
    assert len(np.unique(own, axis=0)) == 2
    assert len(set(own[0])) == 1


def test_metrics_are_means_and_none_without_views():
    assert view_metrics([]) == []
    views = [view(psnr=30.0), view("p5", psnr=34.0)]
    told = {metric.name: metric.value for metric in view_metrics(views)}
    assert told["psnr_stitched"] == pytest.approx(32.0)
    assert told["border_step_before"] == 9.0
    assert "psnr_z_buffered" not in told
    steps = [replace(v, before=ColorSteps(5.0, 1.0, 2)) for v in views]
    assert {m.name: m.value for m in view_metrics(steps)}["border_step_before"] == 5.0


@pytest.fixture
def front():
    """A plain wall that two photographs texture, looked at from between them."""
    cameras = [pinhole(center=(x, 0, 0)) for x in (-0.1, 0.1)]
    meshes = [labelled(wall(), 0, 0), labelled(wall(), 1, 1)]
    return cameras, meshes


def test_a_wall_of_one_colour_is_rendered_exactly_in_every_way(front):
    cameras, meshes = front
    camera = pinhole()
    truth = plain(camera, 153)[..., :3].astype(np.float32) / 255
    known = np.zeros(truth.shape[:2], bool)
    known[20:40, 20:40] = True
    told = held_out_view(
        "p", camera, truth, known, "it", meshes, {"simplified": meshes[0]}, cameras,
        lambda k: plain(cameras[k], 153),
    )  # fmt: skip
    assert told is not None
    assert set(told.quality) == set(WAYS) - {"reconstructed"}
    for way, quality in told.quality.items():
        assert quality.psnr > 50.0, way
        assert quality.ssim > 0.999, way
    assert told.mask[~known].sum() == 0
    assert told.mask.sum() == known.sum()


def test_where_nothing_is_known_nothing_is_compared(front):
    cameras, meshes = front
    camera = pinhole()
    truth = plain(camera, 153)[..., :3].astype(np.float32) / 255
    none = np.zeros(truth.shape[:2], bool)
    args = ("p", camera, truth, none, "it", meshes, {}, cameras, lambda k: plain(cameras[k], 153))
    assert held_out_view(*args) is None


def test_a_darker_photograph_is_told_by_the_noise_it_injects(front):
    """Both photographs 10 of 255 too dark: 20 log10(255 / 10) dB, in every way."""
    cameras, meshes = front
    camera = pinhole()
    truth = plain(camera, 153)[..., :3].astype(np.float32) / 255
    known = np.zeros(truth.shape[:2], bool)
    known[20:40, 20:40] = True
    told = held_out_view(
        "p", camera, truth, known, "it", meshes, {}, cameras, lambda k: plain(cameras[k], 143)
    )
    assert told is not None
    for way, quality in told.quality.items():
        assert quality.psnr == pytest.approx(20 * np.log10(255 / 10), abs=0.3), way
