"""Photographs developed in a project: colour against the truth, exposure, products, refusals."""

from __future__ import annotations

import json
import shutil
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import tifffile

from stages.develop.calibrating import LensLight, lens_of, linearity_of
from stages.main import PIPELINE
from tests.photos.conftest import BLACK, METADATA, WHITE
from tests.stages.conftest import metrics_of
from workbench.color.spaces import delta_e2000, lab_from_xyz_d50, working_space
from workbench.errors import InputError, SettingsError
from workbench.formats.dng import write_dng
from workbench.formats.icc_profile import read_matrix_profile
from workbench.photos.calibration_notes import CalibrationNotes
from workbench.photos.vignetting import Vignetting
from workbench.pipeline.progress import Progress
from workbench.pipeline.runner import RunRequest, run_pipeline
from workbench.project.creation import create_project
from workbench.project.project import Project

BLOCK_PX = 10
SMALL = (
    *("--size", "small", "--scans", "1", "--photos", "1"),
    *("--set", "photos.camera.long_side_px=720", "--set", "photos.camera.short_side_px=480"),
    *("--set", "photos.rendering.truth=full", "--set", "photos.surface.indirect_rays=8"),
    *("--set", "photos.charts.linearity_distances_m=[1.9,2.7,3.9]"),
)


def developed(project: Path, **options: Any) -> dict[str, Any]:
    """Run ``develop`` alone, in this process; returns what the run tells of it."""
    opened = Project(project)
    request = RunRequest(only="develop", overrides={"develop": options}, workers=1)
    (told,) = run_pipeline(PIPELINE, opened, request, Progress(quiet=True))
    return told


def calibration_of(project: Path) -> dict[str, Any]:
    return Project(project).store.load("color_calibration")


def entries_of(project: Path) -> dict[str, dict[str, Any]]:
    inventory = Project(project).store.load("photo_inventory")
    return {entry["name"]: entry for entry in inventory["photos"]}


def albedo_delta_e(project: Path, name: str, tint: Sequence[float] = (1, 1, 1)) -> np.ndarray:
    """CIEDE2000 (n,) of the object's own albedo, none of it a patch of the chart.

    Protocol. The renderer's truth gives, at every pixel, the albedo of the surface and the light
    on it (``diffuse``: the level of a white diffuser there, colour included). The developed
    value over that light is an albedo up to one factor, for 1 in a developed photograph is a
    white diffuser where the chart stood; that one factor is the median over the photograph, and
    nothing else is fitted, neither per pixel nor per channel. Blocks of 10 × 10 pixels are
    compared that lie wholly on the object, in the flash's light and off its reflections
    (specular below 2 % of what the diffuse surface sends), so that noise and the demosaicing of
    edges do not count as colour.
    """
    truth = project / "truth" / "photos"
    seen = Project(project).store.load("developed_photos", name).values * np.array(tint)
    with np.load(truth / "depth" / f"{name}.npz") as arrays:
        light, shine = arrays["diffuse"].astype(float), arrays["specular"].astype(float)
    albedo = cv2.imread(str(truth / "albedo" / f"{name}.png"), cv2.IMREAD_UNCHANGED)
    albedo = albedo[..., ::-1].astype(float) / 65535
    on_object, in_shadow = (
        cv2.imread(str(truth / part / f"{name}.png"), 0) > 127 for part in ("object", "shadow")
    )
    level = light.mean(axis=2)
    sound = on_object & ~in_shadow & (level > 0.15)
    sound &= shine < 0.02 * level * albedo.mean(axis=2)
    rows, cols = (side // BLOCK_PX for side in sound.shape)

    def blocks(picture: np.ndarray) -> np.ndarray:
        part = picture[: rows * BLOCK_PX, : cols * BLOCK_PX]
        return part.reshape(rows, BLOCK_PX, cols, BLOCK_PX, -1).mean(axis=(1, 3))

    whole = blocks(sound[..., None].astype(float))[..., 0] == 1.0
    found, true = blocks(seen / np.maximum(light, 1e-3))[whole], blocks(albedo)[whole]
    found /= np.median(found.sum(axis=1) / true.sum(axis=1))
    to_xyz = working_space("rec709").xyz_d50_from_rgb.T
    return delta_e2000(*(lab_from_xyz_d50(np.maximum(c, 0) @ to_xyz) for c in (found, true)))


@pytest.fixture(scope="module")
def statue(simulated) -> Path:
    """Seed 1, with the distances of the linearity frames noted, developed."""
    project = simulated("--scene", "statue", "--seed", "1", *SMALL)
    notes = '[distances_m]\n"linearity_00.dng" = 1.9\n"linearity_01.dng" = 2.7\n'
    notes += '"linearity_02.dng" = 3.9\n'
    (project / "calibration" / "notes.toml").write_text(notes)
    developed(project)
    return project


@pytest.fixture
def copied(statue: Path, tmp_path: Path) -> Path:
    """The developed statue, to change."""
    return Path(shutil.copytree(statue, tmp_path / "copy"))


def test_colours_are_those_of_the_chart_and_of_what_is_no_chart(statue: Path) -> None:
    told = calibration_of(statue)
    assert told["calibrated"]
    assert told["found_by"] == "detector"
    assert told["edition"] == "after_2014"
    assert told["mean_delta_e2000"] <= 0.5, "1.5 is asked for"
    assert told["left_out_mean_delta_e2000"] <= 0.6
    (check,) = told["checks"].values()
    assert check["mean_delta_e2000"] <= 0.6
    apart = albedo_delta_e(statue, "photo_000")
    assert len(apart) > 150
    assert apart.mean() <= 1.5, "2.5 is asked for"


def test_the_protocol_would_tell_a_wrong_colour(statue: Path) -> None:
    assert albedo_delta_e(statue, "photo_000", (1.15, 1.0, 1.0)).mean() > 2.5
    assert albedo_delta_e(statue, "photo_000", (1.0, 1.0, 0.85)).mean() > 2.5


def test_without_a_chart_it_says_so(copied: Path) -> None:
    calibrated = albedo_delta_e(copied, "photo_000").mean()
    told = developed(copied, chart="none")
    assert not calibration_of(copied)["calibrated"]
    assert "not colour calibrated: no chart was looked for" in told["warnings"]
    assert entries_of(copied)["photo_000"]["color"].startswith("the camera's white balance")
    # This body strays from its maker's matrix, and its white balance errs.
    assert 1.3 * calibrated < albedo_delta_e(copied, "photo_000").mean() < 8.0


def test_charts_are_told_from_photographs_of_the_object(statue: Path) -> None:
    charts = {name for name, entry in entries_of(statue).items() if entry["is_chart"]}
    assert charts == {"chart_00", "chart_01"}


def test_light_falls_with_the_square_and_to_the_corners(statue: Path) -> None:
    told = calibration_of(statue)
    linearity = told["linearity"]
    assert linearity["metric"]
    assert linearity["distances"] == [1.9, 2.7, 3.9]
    assert linearity["residual"] < 0.025, "the flash itself spreads by 1 %"
    assert linearity["exponent"] == pytest.approx(-2.0, abs=0.05)
    # The lens of the simulation: cos³ and 6 % by the barrel; its flash's beam: 7.6 %.
    corner = (1 + 0.5 * (36**2 + 24**2) / 2 / 50.6**2) ** -1.5 * (1 - 0.06) * (1 - 0.076)
    assert 1 + sum(told["vignetting"]["coefficients"]) == pytest.approx(corner, abs=0.02)


def test_the_products_are_what_any_reader_takes_them_for(statue: Path) -> None:
    store = Project(statue).store
    path = store.path("developed_photos", "photo_000")
    picture = store.load("developed_photos", "photo_000")
    independent = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)[..., ::-1]
    assert independent.dtype == np.uint16
    np.testing.assert_allclose(picture.values, independent * (picture.scale / 65535), rtol=1e-6)
    assert independent.max() < 65535, "there is headroom"
    with tifffile.TiffFile(path) as file:
        embedded = file.pages.first.tags["InterColorProfile"].value
    profile = read_matrix_profile(embedded)
    assert profile is not None
    space = working_space("rec709").xyz_d50_from_rgb
    np.testing.assert_allclose(profile.xyz_d50_from_rgb, space, atol=1e-4)
    np.testing.assert_allclose(profile.curves[0], np.linspace(0, 1, 65536), atol=1e-6)
    mask = store.load("unclipped_masks", "photo_000")
    assert mask.shape == picture.values.shape[:2] == (720, 480)
    entry = entries_of(statue)["photo_000"]
    assert entry["size"] == [480, 720]
    assert entry["flash_fired"] is True
    assert entry["lens"] == "Simulated 50mm f/2.8 Macro"
    assert (entry["exposure_time_s"], entry["f_number"], entry["iso"]) == (0.004, 11.0, 200.0)
    assert Project(statue).store.load("photo_inventory")["scale"] == picture.scale


def test_same_inputs_give_same_bytes_and_nothing_is_done_twice(copied: Path) -> None:
    store = Project(copied).store
    products = ("developed_photos", "unclipped_masks", "photo_inventory", "color_calibration")
    before = {p: p.read_bytes() for name in products for p in store.paths(name)}
    assert len(before) == 2 * 3 + 2
    assert developed(copied)["action"] == "fresh"
    shutil.rmtree(copied / "work")
    assert developed(copied)["action"] == "run"
    assert {p: p.read_bytes() for name in products for p in store.paths(name)} == before


def test_half_size_shows_the_same_light(copied: Path) -> None:
    full = Project(copied).store.load("developed_photos", "photo_000").values
    developed(copied, half_size=True)
    half = Project(copied).store.load("developed_photos", "photo_000").values
    assert half.shape == (360, 240, 3)
    # In blocks, for a pixel of half size is not where the two by two it was made of were.
    one, other = (cv2.resize(p, (24, 36), interpolation=cv2.INTER_AREA) for p in (full, half))
    lit = one[..., 1] > 0.05
    assert np.median(np.abs(other - one)[lit] / one[lit]) < 0.015
    assert Project(copied).store.load("photo_inventory")["pixel_step"] == 2


def test_corners_by_hand_give_the_same_colours(copied: Path) -> None:
    charts = json.loads((copied / "truth" / "photos" / "charts.json").read_text())["charts"]
    corners = {Path(c["file"]).stem: c["board_corners_px"] for c in charts}
    before = calibration_of(copied)
    developed(copied, chart="chart_01", chart_corners={"chart_01": corners["chart_01"]})
    after = calibration_of(copied)
    assert after["found_by"] == "corners"
    assert after["chart"] == "chart_01"
    assert after["checks"] == {}
    assert after["mean_delta_e2000"] <= 0.5
    if before["chart"] == "chart_01":
        np.testing.assert_allclose(after["matrix"], before["matrix"], atol=0.02)


def test_prophoto_and_roots_keep_the_promise_too(copied: Path) -> None:
    developed(copied, space="prophoto", matrix="root_polynomial")
    told = calibration_of(copied)
    assert told["mean_delta_e2000"] <= 0.5
    assert np.array(told["matrix"]).shape == (3, 6)
    picture = Project(copied).store.load("developed_photos", "chart_00")
    assert picture.space == "prophoto"
    # No pigment lies outside: cyan's red is positive, as it is not in Rec. 709.
    corners = np.array(told["corners_px"])
    assert picture.values.min() >= 0.0
    assert len(corners) == 4
    assert entries_of(copied)["chart_00"]["beyond_range"] < 1e-3


def test_names_that_belong_to_nothing_are_told(copied: Path) -> None:
    with pytest.raises(SettingsError, match="no photograph of this name"):
        developed(copied, chart="chart_99")
    with pytest.raises(SettingsError, match="no photograph of this name"):
        developed(copied, chart_corners={"photo_9": [[0, 0], [1, 0], [1, 1], [0, 1]]})


def test_a_broken_photograph_is_named_and_nothing_claims_to_be_done(copied: Path) -> None:
    broken = copied / "photos" / "photo_000.dng"
    broken.write_bytes(broken.read_bytes()[:40_000])
    with pytest.raises(InputError) as error:
        developed(copied)
    assert error.value.file == str(broken)
    record = json.loads((copied / "work" / "develop" / "record.json").read_text())
    assert record["state"] != "done"


def _shots(folder: Path, settings: dict[str, dict[str, Any]]) -> Path:
    """One scene photographed with several settings, by their exposure, flashless."""
    folder.mkdir()
    rng = np.random.default_rng(8)
    light = 0.05 + 0.1 * rng.random((20, 30))
    light = np.kron(light, np.ones((8, 8)))
    for name, changes in settings.items():
        dim = changes.pop("dim", 1.0)
        told = replace(METADATA, flash_fired=False, **changes)
        exposure = told.exposure_time_s * told.iso / told.f_number**2 / (400 / 125 / 64)
        number = BLACK + (WHITE - BLACK) * light * exposure * dim
        write_dng(folder / f"{name}.dng", np.rint(number).astype(np.uint16), told)
    return folder


def _look(**changes: Any) -> dict[str, Any]:
    facts = {"camera": "One", "lens": "A", "focal_length_mm": 50.0}
    return {"facts": facts | changes, "linearised_from": None, "middle": 0.0}


def test_a_charts_own_size_tells_its_distance() -> None:
    looks, files = {}, {}
    for k, distance in enumerate((1.5, 2.0, 3.0, 4.0)):
        means = np.full((24, 3), 0.1)
        means[18] = 1.4 / distance**2
        chart = {
            "width_px": 300.0 / distance,
            "unfit": None,
            "patches": {"means": means.tolist()},
        }
        looks[f"chart_{k}"] = _look() | {"chart": chart}
        files[f"chart_{k}"] = f"chart_{k}.dng"
    # One of half the sensitivity, brought back by its gain.
    looks["chart_3"]["chart"]["patches"]["means"][18][1] *= 0.5
    found = linearity_of(looks, CalibrationNotes(), files, {"chart_3": 2.0})
    assert found
    assert not found.metric
    np.testing.assert_allclose(found.distances, [1.0, 4 / 3, 2.0, 8 / 3])
    assert found.residual < 1e-9
    missed = linearity_of(looks, CalibrationNotes(), files, {})
    assert missed.residual > 0.2


def test_frames_at_noted_distances_count_where_they_are_not_clipped() -> None:
    distances = {"a": 1.0, "b": 1.5, "c": 2.0, "d": 3.0}
    looks = {name: _look() | {"middle": 0.9 / d**2} for name, d in distances.items()}
    looks["a"]["middle"] = None
    files = {name: f"{name}.dng" for name in distances}
    notes = CalibrationNotes({f"{name}.dng": d for name, d in distances.items()})
    found = linearity_of(looks, notes, files, {})
    assert found
    assert found.metric
    assert found.names == ("b", "c", "d")
    assert found.residual < 1e-9
    looks["b"]["middle"] = None
    assert not linearity_of(looks, notes, files, {})


def test_a_lens_is_not_evened_out_by_the_flat_frame_of_another() -> None:
    light = LensLight(Vignetting((-0.3, 0.0, 0.0), 0.001), lens_of(_look()))
    assert light.of(_look()) is light.found
    for other in ({"lens": "B"}, {"focal_length_mm": 35.0}, {"camera": "Two"}):
        assert light.of(_look(**other)) is None


def test_photographs_of_other_settings_come_to_one_exposure(tmp_path: Path) -> None:
    settings: dict[str, dict[str, Any]] = {
        "a": {},
        "b": {},
        "c": {"iso": 800},
        "d": {"exposure_time_s": 1 / 500},
        "e": {"f_number": 4.0},
    }
    photos = _shots(tmp_path / "photos", settings)
    create_project(tmp_path / "p", photos=[photos])
    developed(tmp_path / "p", half_size=True)
    store = Project(tmp_path / "p").store
    one = store.load("developed_photos", "a").values
    for name in "bcde":
        other = store.load("developed_photos", name).values
        assert np.abs(other - one).max() < 0.003 * one.max()
    assert metrics_of(tmp_path / "p", "develop")["exposure_spread"] == pytest.approx(4.0)
    developed(tmp_path / "p", half_size=True, exposure="as_shot")
    brighter = store.load("developed_photos", "c").values
    assert brighter.mean() == pytest.approx(
        2 * store.load("developed_photos", "a").values.mean(), rel=0.01
    )


def test_the_photograph_that_does_not_belong_is_named(tmp_path: Path) -> None:
    settings: dict[str, dict[str, Any]] = {f"p{k}": {} for k in range(7)}
    settings["p4"] = {"dim": 0.1}
    settings["p5"] = {"focal_length_mm": 70.0}
    photos = _shots(tmp_path / "photos", settings)
    create_project(tmp_path / "p", photos=[photos])
    warnings = developed(tmp_path / "p")["warnings"]
    named = [text for text in warnings if text.startswith("p")]
    assert len(named) == 2
    assert any(text.startswith("p4: 3.") and "darker" in text for text in named)
    assert any(text.startswith("p5: focal length 70 (most: 35)") for text in named)


def test_pictures_that_are_not_raw_are_taken_and_said_to_be(tmp_path: Path) -> None:
    from PIL import Image

    folder = tmp_path / "photos"
    folder.mkdir()
    Image.fromarray(np.full((40, 60, 3), 188, np.uint8)).save(folder / "a.jpg", quality=100)
    create_project(tmp_path / "p", photos=[folder])
    told = developed(tmp_path / "p")
    assert any("not RAW" in text and "a" in text for text in told["warnings"])
    picture = Project(tmp_path / "p").store.load("developed_photos", "a")
    np.testing.assert_allclose(picture.values, 0.5029, atol=0.005)
    assert entries_of(tmp_path / "p")["a"]["linearised_from"] == "sRGB (the file has no profile)"


def test_without_photographs_the_stage_is_left_out(tmp_path: Path) -> None:
    from workbench.pipeline.planner import make_plan

    surface = tmp_path / "s.ply"
    surface.write_text(
        "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\n"
        "property float z\nelement face 1\nproperty list uchar int vertex_indices\nend_header\n"
        "0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n"
    )
    project = create_project(tmp_path / "p", geometry=surface)
    plan = {planned.stage.name: planned for planned in make_plan(PIPELINE, project)}
    assert (plan["develop"].action, plan["develop"].reason) == ("left out", "no photographs")


def test_real_charts(shared_data, tmp_path: Path) -> None:
    raw = [shared_data("raw", "canon", f"CRW_{n}.CRW") for n in ("0101", "0119", "0304")]
    create_project(tmp_path / "p", photos=raw)
    told = developed(tmp_path / "p", half_size=True, chart="CRW_0304.CRW")
    found = calibration_of(tmp_path / "p")
    if not found["calibrated"]:
        pytest.skip("this version of OpenCV's detector misses the chart")
    assert found["mean_delta_e2000"] <= 2.5
    entries = entries_of(tmp_path / "p")
    assert entries["CRW_0119"]["flash_fired"] is True
    # Another camera's matrix is not lent.
    assert entries["CRW_0101"]["color"] != "chart"
    assert any("another camera" in text for text in told["warnings"])
    corners = [[168, 179], [2077, 128], [2090, 1383], [199, 1438]]
    developed(tmp_path / "p", half_size=True, chart="CRW_0101", chart_corners={"CRW_0101": corners})
    assert calibration_of(tmp_path / "p")["mean_delta_e2000"] <= 2.9


@pytest.mark.slow
@pytest.mark.parametrize("seed", [1, 2, 3, 4, 5])
def test_every_seed_keeps_the_bounds(simulated, seed: int) -> None:
    photos = ("--scans", "1", "--photos", "3", "--set", "photos.rendering.truth=full")
    project = simulated("--scene", "statue", "--seed", str(seed), "--size", "small", *photos)
    developed(project)
    told = calibration_of(project)
    assert told["mean_delta_e2000"] <= 1.5
    assert all(check["mean_delta_e2000"] <= 1.5 for check in told["checks"].values())
    for name in ("photo_000", "photo_001", "photo_002"):
        assert albedo_delta_e(project, name).mean() <= 2.5
