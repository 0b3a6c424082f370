"""What a report says and shows of colour."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from stages.verify.color import color_chapter
from tests.color.blending_scene import FLASH, ball, colored, looked, paint, photographed, ring
from tests.verification.test_color_truth import ramp, sheet
from workbench.color.blending import blended
from workbench.errors import InputError
from workbench.formats.gltf import linear_from_srgb, srgb_from_linear
from workbench.formats.linear_tiff import LinearPicture
from workbench.geometry.photo_camera import PhotoCamera
from workbench.geometry.surface_rays import SurfaceRays
from workbench.geometry.transforms import rigid
from workbench.render import palette
from workbench.render.camera import orbit_camera
from workbench.render.shading import View
from workbench.surface.provenance import INPAINTED, PHOTOGRAPHED, UNCOLORED
from workbench.verification.color_pictures import (
    ModelInPhoto,
    albedo_row,
    difference_row,
    same_camera_row,
    told_row,
)
from workbench.verification.color_sections import color_section
from workbench.verification.color_truth import compared_albedo
from workbench.verification.report_content import (
    Paragraph,
    PictureRow,
    Plot,
    Section,
    Table,
    TextList,
)

LIGHT: dict[str, Any] = {
    "position_in_camera_m": [-0.13, 0.02, 0.01],
    "reference_distance_m": 2.0,
    "epsilon": 0.1,
    "roughness_deg": 0.0,
    "falloff": [0.3, -0.2],
    "indirect": 0.0,
}
ESTIMATE: dict[str, Any] = {
    "position_sigma_m": [0.004, 0.01, 0.15],
    "condition": 30.0,
    "terms": [
        {"term": "falloff", "kept": True, "spread_without": 0.07, "spread_with": 0.06,
         "certainty": 9.0},
        {"term": "indirect", "kept": False, "spread_without": 0.06, "spread_with": 0.06,
         "certainty": 0.5},
    ],
    "scatter_as_shot": 0.14,
    "scatter_with_gains": 0.13,
    "scatter": 0.04,
    "scatter_held_out": None,
    "converged": True,
}  # fmt: skip


def flash(**changes: Any) -> dict[str, Any]:
    told = {
        "way": "estimated",
        "reason": None,
        "space": "rec709",
        "level": "that of the chart 1.9 m from the camera",
        "gains": {"p0": 0.5, "p1": 0.5, "p2": 0.5, "p3": 0.6, "p4": 0.45, "dark": 3.0},
        "without_flash": ["dark"],
        "light": LIGHT,
        "estimate": ESTIMATE,
    }
    return told | changes


def record(*warnings: str, **metrics: float) -> dict[str, Any]:
    values = {"photographs": 6, "photos_per_vertex": 4.0, "blended_scatter": 3.5,
              "seam_step": 1.0, "step_noise": 2.0, "doubted_share": 20.0,
              "inpaint_factor": 0.25} | metrics  # fmt: skip
    return {
        "metrics": [{"name": name, "value": value} for name, value in values.items()],
        "warnings": list(warnings),
        "options": {"robust": "median", "least_weight": 0.0},
    }


def origins() -> np.ndarray:
    """Of a sheet of 2 × 2 quads: the left third inpainted, one corner bare."""
    found = np.full(9, PHOTOGRAPHED, np.uint8)
    found[[0, 3, 6]], found[8] = INPAINTED, UNCOLORED
    return found


def of(section: Section, kind: type) -> list[Any]:
    return [block for block in section.blocks if isinstance(block, kind)]


def words(section: Section) -> str:
    return " ".join(paragraph.text for paragraph in of(section, Paragraph))


def table(section: Section, title: str) -> dict[str, tuple]:
    (found,) = [t for t in of(section, Table) if t.columns[0].title == title]
    return {row[0]: row[1:] for row in found.rows}


def test_shares_are_of_the_area():
    section = color_section(sheet(2), origins(), flash(), record())
    told = table(section, "Colour")
    # Corners of two triangles and of one stand for 2/24 and 1/24 of the square, sides for 3/24.
    assert told["inpainted"] == pytest.approx((6 / 24, 100 * 6 / 24))
    assert told["without colour"] == pytest.approx((2 / 24, 100 * 2 / 24))
    assert told["photographed"][1] == pytest.approx(100 * 16 / 24)
    said = words(section)
    assert "6 photographs, 1 of them taken without flash, tell the colour of 66.7 %" in said
    assert "25.0 % is inpainted" in said
    assert "8.3 % has no colour" in said
    assert "The level of white is that of the chart 1.9 m from the camera." in said
    assert "left 25 % of the residual" in said


def test_the_flash_is_told_with_what_is_not_known_of_it():
    section = color_section(sheet(2), origins(), flash(), record("look twice"))
    said = words(section)
    assert "loose along the view (± 150 mm)" in said
    assert "sideways" not in said
    told = table(section, "Flash")
    assert told["to the left of the lens"] == ("130 mm", "4 mm")
    assert told["below the lens"] == ("20 mm", "10 mm")
    # exp(0.3 sin 15°) and exp(−0.2 · −sin 15°)
    assert told["light 15° to the right, of that ahead"][0] == "108 %"
    assert told["light 15° upwards, of that ahead"][0] == "105 %"
    assert told["light 15° to the left, of that ahead"][0] == "93 %"
    terms = table(section, "Beyond distance and incidence")
    assert terms["a beam brighter in some directions"][0] == "taken out"
    assert terms["light from all around"][0] == "left out: not surely better"
    spread = table(section, "Spread of luminance")
    assert spread["between photographs, as taken"] == (pytest.approx(14.0),)
    assert spread["the same at places the flash was not fitted to"] == (None,)
    assert [t.items for t in of(section, TextList)] == [("look twice",)]
    sure = flash(estimate=ESTIMATE | {"position_sigma_m": [0.01, 0.01, 0.01], "converged": False})
    said = words(color_section(sheet(2), origins(), sure, record()))
    assert "5 % of the distance or better every way" in said
    assert "had not come to rest" in said


def test_the_light_itself_says_what_is_taken_out():
    """A term may stay in the light without its own trial being sure."""
    there = flash(light=LIGHT | {"indirect": 0.2, "falloff": []})
    section = color_section(sheet(2), origins(), there, record())
    terms = table(section, "Beyond distance and incidence")
    assert terms["light from all around"][0] == "taken out, but not surely better"
    assert terms["a beam brighter in some directions"][0].startswith("left out")
    assert not any("15°" in label for label in table(section, "Flash"))


def test_gains_are_of_photographs_with_flash():
    section = color_section(sheet(2), origins(), flash(), record())
    (plot,) = of(section, Plot)
    assert "<svg" in plot.svg
    assert "least in p4 (90.0 %), most in p3 (120.0 %)" in plot.caption
    assert "dark" not in plot.data["gains"]


def test_without_a_flash_the_reason_is_told():
    left_out = flash(way="left out", reason="not asked for", light=None, estimate=None,
                     gains={"p0": 1.0}, without_flash=[])  # fmt: skip
    section = color_section(sheet(2), np.zeros(9, np.uint8), left_out, record(photographs=1))
    assert "in the light" not in section.title
    said = words(section)
    assert "No flash was taken out" in said
    assert "not asked for" in said
    assert "npainted" not in said
    assert not of(section, Plot)
    assert {t.columns[0].title for t in of(section, Table)} == {"Colour", "Spread of luminance"}


def test_the_truth_has_a_row_for_each_way(rng):
    truth = rng.uniform(0.1, 0.6, (9, 3))
    found = compared_albedo(1.1 * truth, origins(), "rec709", truth, 0.5 * truth**1.2, 0.6 * truth)
    section = color_section(sheet(2), origins(), flash(), record(), truth=found)
    rows = table(section, "Against the true albedo")
    assert rows["distance alone taken out, level matched"][-1] == pytest.approx(1 / 0.6, rel=1e-3)
    assert rows["as recovered"][-1] == 1.0
    assert rows["as recovered"][1] == found.corrected.mean
    assert rows["inpainted, from the paint itself"][0] == 3
    alone = compared_albedo(truth, np.zeros(9, np.uint8), "rec709", truth)
    section = color_section(sheet(2), origins(), flash(), record(), truth=alone)
    assert "distance alone taken out, level matched" not in table(
        section, "Against the true albedo"
    )


@pytest.fixture(scope="module")
def views() -> dict[str, View]:
    """A ball whose left half, as seen, has other vertices than its right."""
    mesh = ball(4)
    return {"front": View.of(mesh, orbit_camera(mesh.vertices, 0.0, 0.0, 120, 120))}


def test_colours_alone_are_those_given(views):
    colors = np.full((len(views["front"].mesh.vertices), 3), (180, 90, 40), np.uint8)
    alone, lit = albedo_row(views, colors).pictures
    middle = alone.pixels[40:80, 40:80].reshape(-1, 3).astype(int)
    assert np.abs(middle - (180, 90, 40)).max() <= 1
    assert alone.caption == "Front, colours alone"
    assert np.ptp(lit.pixels[40:80, 40:80, 0]) > 20


def test_origins_and_numbers_have_their_colours(views):
    n = len(views["front"].mesh.vertices)
    for kind, color in ((PHOTOGRAPHED, palette.PROVENANCE_COLORS[0]),
                        (INPAINTED, palette.PROVENANCE_COLORS[1]),
                        (UNCOLORED, palette.UNKNOWN_COLOR)):  # fmt: skip
        row = told_row(views, np.full(n, kind, np.uint8), np.full(n, 7))
        shown = linear_from_srgb(row.pictures[0].pixels[60, 60])
        light = linear_from_srgb(np.array(color, np.uint8))
        assert shown / shown.max() == pytest.approx(light / light.max(), abs=0.03)
        assert color in {entry.color for entry in row.legend}
    bare = told_row(views, np.full(n, UNCOLORED, np.uint8), np.zeros(n, int))
    shade = bare.pictures[1].pixels[60, 60].astype(int)
    assert np.ptp(shade) < 10


def test_differences_share_one_scale(views):
    n = len(views["front"].mesh.vertices)
    row = difference_row(views, {"as taken": np.full(n, 8.0), "as recovered": np.full(n, 0.1)})
    taken, recovered = (picture.pixels[60, 60].astype(int) for picture in row.pictures)
    assert recovered.sum() > taken.sum() + 150
    assert [picture.caption for picture in row.pictures] == [
        "As taken, front",
        "As recovered, front",
    ]
    nothing = difference_row(views, {"as taken": np.full(n, np.nan)})
    assert np.ptp(nothing.pictures[0].pixels[60, 60].astype(int)) < 10


# Square on but turned and off the middle, by a lens that distorts.
CAMERA = PhotoCamera(
    "OPENCV", 600, 400, (500.0, 500.0, 310.0, 190.0, -0.1, 0.02, 1e-3, -1e-3),
    rigid([[0.96, 0.28, 0.0], [0.28, -0.96, 0.0], [0.0, 0.0, -1.0]], [-0.7, 0.3, 2.0]),
)  # fmt: skip


def pictured(camera: PhotoCamera) -> np.ndarray:
    """The ramp on the sheet as the camera sees it, by its own rays; NaN beside it."""
    columns, rows = np.meshgrid(np.arange(camera.width) + 0.5, np.arange(camera.height) + 0.5)
    ways = camera.directions(np.column_stack([columns.ravel(), rows.ravel()]))
    places = camera.center - (camera.center[2] / ways[:, 2])[:, None] * ways
    inside = ((places[:, :2] >= 0.0) & (places[:, :2] <= 1.0)).all(axis=1)
    shown = np.where(inside[:, None], ramp(places), np.nan)
    return shown.reshape(camera.height, camera.width, 3)


@pytest.mark.parametrize("reduced", [1, 2])
def test_model_and_photograph_lie_on_one_another(reduced):
    """Each pixel shows the same place in both, also of a photograph developed smaller."""
    mesh = sheet(8)
    seen = ModelInPhoto.of(SurfaceRays(mesh), CAMERA, side_px=220)
    assert seen is not None
    assert max(seen.height, seen.width) == 220
    picture = pictured(CAMERA)[::reduced, ::reduced].astype(np.float32)
    photograph = seen.of_photo(picture, (CAMERA.width, CAMERA.height))
    model = seen.painted(ramp(mesh.vertices))
    both = np.isfinite(photograph).all(axis=2) & (seen.cover == 1.0)
    assert both.mean() > 0.3
    # The ramp rises by 0.5 over the sheet, some 150 pixels: half a pixel is 0.002.
    assert np.abs(photograph - model)[both].max() < 0.004 * reduced
    # Nothing of the sheet is cropped away.
    assert seen.cover[[0, -1]].max() == seen.cover[:, [0, -1]].max() == 0.0


def test_a_camera_that_looks_away_shows_nothing():
    behind = rigid(np.eye(3), [0.0, 0.0, -5.0])
    away = replace(CAMERA, camera_from_world=behind @ CAMERA.camera_from_world)
    assert ModelInPhoto.of(SurfaceRays(sheet(2)), away) is None


def test_a_row_has_one_exposure():
    mesh = sheet(8)
    seen = ModelInPhoto.of(SurfaceRays(mesh), CAMERA, side_px=120)
    assert seen is not None
    photograph = np.nan_to_num(seen.of_photo(pictured(CAMERA).astype(np.float32), (600, 400)))
    bright, dark = np.full((81, 3), 0.8), np.full((81, 3), [0.1, 0.2, 0.05])
    dark[40] = np.nan
    row = same_camera_row("p7", seen, photograph, [("A", bright), ("B", dark)], "rec709")
    taken, first, second = (picture.pixels for picture in row.pictures)
    inside = seen.cover == 1.0
    assert (first[inside] == 255).all()
    grey = (second == palette.UNKNOWN_COLOR).all(axis=2) & inside
    assert 0 < grey.sum() < 0.1 * inside.sum()
    expected = srgb_from_linear(np.array([[0.1, 0.2, 0.05]]) / 0.8)
    there = inside & ~grey
    assert np.abs(second[there].astype(int) - expected).max() <= 2
    level = linear_from_srgb(taken[inside]) * 0.8
    shown = np.clip(photograph[inside], 0.0, 0.8)
    assert np.abs(level - shown).max() < 0.01
    assert "× 1.25" in row.caption


class Folder:
    """What the stages left, in memory."""

    def __init__(self, **products: Any) -> None:
        self.products = products

    def load_if_there(self, name: str, item: str | None = None) -> Any:
        found = self.products.get(name)
        return found[item] if found is not None and item is not None else found

    load = load_if_there

    def items(self, name: str) -> tuple[str, ...]:
        return tuple(sorted(self.products.get(name, ())))


@pytest.fixture(scope="module")
def left() -> tuple[Any, Folder]:
    """A painted ball, photographs of it all round, and what the stages found."""
    mesh, gain = ball(3), 0.9
    poses, seen, lit, pictures, photos = {}, {}, {}, {}, []
    for number, camera in enumerate(ring(8, size=120)):
        name = f"photo_{number}"
        picture, mask = photographed(camera, gain=gain)
        one = looked(mesh, camera, picture, mask)
        poses[name] = {"model": camera.model, "size": [120, 120], "params": list(camera.params),
                       "camera_from_world": camera.camera_from_world.tolist()}  # fmt: skip
        seen[name] = one.seen.arrays()
        lit[name] = {"lit": np.ones(len(one.seen), np.float32)}
        pictures[name] = LinearPicture(picture, "rec709", 1.0, b"")
        photos.append(colored(mesh, one, gain))
    blending = blended(photos, len(mesh.vertices))
    told = np.isfinite(blending.colors).all(axis=1)
    light = LIGHT | {
        "position_in_camera_m": FLASH.position_in_camera.tolist(),
        "reference_distance_m": FLASH.reference_distance,
    }
    return mesh, Folder(
        surface_color={
            "color": np.where(told[:, None], blending.colors, 0.3).astype(np.float32),
            "color_provenance": np.where(told, PHOTOGRAPHED, INPAINTED).astype(np.uint8),
            "photos": blending.photos,
        },
        flash=flash(gains=dict.fromkeys(seen, gain), without_flash=[], light=light),
        records={"color": record()},
        photo_poses={"photos": poses},
        photo_observations=seen,
        photo_lighting=lit,
        developed_photos=pictures,
        truth_surface_albedo={"albedo": paint(mesh.vertices).astype(np.float32)},
    )


ASKED: dict[str, Any] = {"up": "z", "front_deg": 0.0, "width_px": 120, "model_from_local": None}


def test_the_chapter_tells_what_correcting_is_worth(left):
    mesh, folder = left
    (section,), metrics = color_chapter(folder, mesh, mesh, **ASKED)
    told = {metric.name: metric.value for metric in metrics}
    assert told["albedo_delta_e_mean"] < 1.5
    assert told["albedo_delta_e_distance_only_mean"] > 3.0 * told["albedo_delta_e_mean"]
    assert told["albedo_delta_e_uncorrected_mean"] > told["albedo_delta_e_distance_only_mean"]
    rows = of(section, PictureRow)
    captions = [picture.caption for picture in rows[2].pictures]
    assert captions == ["As taken", "Blended as taken", "Distance taken out",
                        "Distance, incidence and all", "True albedo"]  # fmt: skip
    assert [row.pictures[0].caption for row in rows] == [
        "Front, colours alone", "Front, origin", "As taken", "As taken, front",
    ]  # fmt: skip


def test_without_truth_or_colours_there_is_less_to_say(left):
    mesh, folder = left
    (section,), metrics = color_chapter(folder, mesh, None, **ASKED)
    assert metrics == []
    assert len(of(section, PictureRow)) == 3
    assert len(of(section, PictureRow)[2].pictures) == 4
    without = Folder(**{k: v for k, v in folder.products.items() if k != "surface_color"})
    assert color_chapter(without, mesh, mesh, **ASKED) == ((), [])
    with pytest.raises(InputError, match="do not belong"):
        color_chapter(folder, ball(2), None, **ASKED)


def test_where_no_flash_was_taken_out_nothing_is_compared(left):
    mesh, folder = left
    dark = flash(way="left out", reason="not asked for", light=None, estimate=None,
                 gains=folder.products["flash"]["gains"], without_flash=[])  # fmt: skip
    (section,), metrics = color_chapter(
        Folder(**folder.products | {"flash": dark}), mesh, mesh, **ASKED
    )
    assert "albedo_delta_e_uncorrected_mean" not in {metric.name for metric in metrics}
    captions = [picture.caption for picture in of(section, PictureRow)[2].pictures]
    assert captions == ["As taken", "As blended", "True albedo"]
