"""Clutter masked away in a project: learned, corrected, applied, and told of."""

import json
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from tests.masking.scenes import photograph
from tests.stages.conftest import metrics_of, workbench
from workbench.formats.mask_png import read_mask_png, write_mask_png
from workbench.project.project import Project


def stages_of(answer: dict) -> dict[str, dict]:
    return {stage["name"]: stage for stage in answer["stages"]}


def error_of(*arguments) -> dict:
    command = [sys.executable, "-m", "stages.main", *map(str, arguments), "--json"]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 2
    return json.loads(done.stdout)["error"]


def drawn(project: Path, role: str, name: str, mask) -> Path:
    path = project / "masks" / role / f"{name}.png"
    path.parent.mkdir(parents=True, exist_ok=True)
    write_mask_png(path, mask)
    return path


@pytest.fixture(scope="module")
def photos(tmp_path_factory):
    """A folder of four photographs and their true masks by name."""
    folder, masks = tmp_path_factory.mktemp("photos"), {}
    for k, centre in enumerate([(0.5, 0.5), (0.4, 0.55), (0.6, 0.45), (0.5, 0.6)]):
        image, masks[f"view_{k}"] = photograph(k, centre=centre)
        Image.fromarray(image).save(folder / f"view_{k}.png")
    return folder, masks


@pytest.fixture(scope="module")
def masked(simulated, photos):
    """A statue scanned and four photographs, with one drawn mask of each kind, up to `fuse`."""
    size = ("--set", "scanner.rows=150", "--set", "scanner.cols=110")
    project = simulated("--scene", "statue", "--seed", "3", "--scans", "6", *size)
    folder, masks = photos
    text = (project / "project.toml").read_text()
    assert "photos = []" in text
    (project / "project.toml").write_text(text.replace("photos = []", f'photos = ["{folder}"]'))
    first = stages_of(workbench("plan", project))["mask"]
    assert (first["action"], first["reason"]) == ("left out", "no training masks")
    workbench("run", project, "--to", "ingest")
    # Once the reflectance was looked at, the plan tells that there may be something to mask.
    told = stages_of(workbench("plan", project))["mask"]["reason"]
    assert "two kinds of surface" in told
    assert "--suggest" in told
    named = workbench("mask", project, "--suggest", "--count", "1")["suggestions"]
    assert [entry["kind"] for entry in named] == ["scan", "photo"]
    scan, photo = (entry["name"] for entry in named)
    truth = read_mask_png(project / "truth" / "masks" / f"{scan}.png")
    drawn(project, "training", scan, truth)
    drawn(project, "training", photo, masks[photo])
    workbench("run", project, "--to", "fuse")
    return project, scan, photo


def clutter_kept(project: Path) -> tuple[float, float]:
    """Shares of the clutter that is kept and of the object that is masked away, of scans."""
    kept = wrong = model = missed = 0
    for file in sorted((project / "truth" / "scans").glob("*.npz")):
        arrays = np.load(file)
        mask = read_mask_png(project / "work" / "mask" / "scans" / f"{file.stem}.png")
        keep = mask.flat[arrays["pixel"]] > 127
        sound = ~(arrays["is_mixed"] | arrays["is_stray"])
        clutter = sound & (arrays["material"] != 0)
        kept, wrong = kept + clutter.sum(), wrong + (clutter & keep).sum()
        own = sound & (arrays["material"] == 0)
        model, missed = model + own.sum(), missed + (own & ~keep).sum()
    return wrong / kept, missed / model


def test_the_support_is_gone_and_the_statue_is_not(masked):
    project, *_ = masked
    wrong, missed = clutter_kept(project)
    assert wrong < 0.005
    assert missed < 0.02
    found = metrics_of(project, "mask")
    assert (found["scans_masked"], found["scans_masked_by_hand"]) == (6, 1)
    # The rest of the pipeline never meets what was masked away.
    samples = sum(
        (read_mask_png(project / "work" / "mask" / "scans" / f"{name}.png") > 127).sum()
        for name in Project(project).store.items("scan_masks")
    )
    given = metrics_of(project, "ingest")["samples"]
    assert samples < 0.9 * given
    assert metrics_of(project, "fuse")["samples_trusted"] <= samples
    arrays = np.load(project / "truth" / "surface.npz")
    statue = arrays["vertices"][arrays["material"] == 0]
    samples_z = np.load(project / "work" / "fuse" / "samples.npz")["points"][:, 2]
    assert len(samples_z)
    assert np.ptp(samples_z) < np.ptp(statue[:, 2]) + 0.02


def test_photographs_are_masked_by_the_same_stage(masked, photos):
    project, _, photo = masked
    _, truth = photos
    for name, true in truth.items():
        found = read_mask_png(project / "work" / "mask" / "photos" / f"{name}.png") > 127
        if name == photo:
            assert np.array_equal(found, true > 127), "what was drawn is used as it was drawn"
        else:
            both, either = (found & (true > 127)).sum(), (found | (true > 127)).sum()
            assert both / either > 0.95
            assert (found & (true <= 127)).sum() < 0.005 * found.size


@pytest.fixture
def own(masked, tmp_path):
    project, scan, photo = masked
    shutil.copytree(project, tmp_path / "project")
    return tmp_path / "project", scan, photo


def test_a_correction_wins_survives_force_and_makes_stale_what_depends_on_it(own):
    project, _, photo = own
    name = next(n for n in ("view_0", "view_1") if n != photo)
    half = np.zeros((240, 240), np.uint8)
    half[:120] = 255
    drawn(project, "corrected", name, half)
    plan = stages_of(workbench("plan", project))
    assert plan["mask"]["action"] == "stale"
    assert f"{name}.png is new" in plan["mask"]["reason"]
    ran = stages_of(workbench("run", project, "--to", "fuse"))
    # A photograph's mask is nothing to the scans.
    assert [ran[s]["action"] for s in ("ingest", "mask", "register", "fuse")] == [
        "fresh", "run", "fresh", "fresh"]  # fmt: skip
    masks = project / "work" / "mask"
    assert np.array_equal(read_mask_png(masks / "photos" / f"{name}.png"), half)
    assert not np.array_equal(read_mask_png(masks / "automatic" / "photos" / f"{name}.png"), half)
    workbench("run", project, "--only", "mask", "--force")
    assert np.array_equal(read_mask_png(masks / "photos" / f"{name}.png"), half)
    # Taken back, the mask is the automatic one again, to the byte.
    (project / "masks" / "corrected" / f"{name}.png").unlink()
    workbench("run", project, "--only", "mask")
    automatic = (masks / "automatic" / "photos" / f"{name}.png").read_bytes()
    assert (masks / "photos" / f"{name}.png").read_bytes() == automatic


def test_a_corrected_scan_is_registered_again_and_one_masked_away_breaks_nothing(own):
    project, scan, _ = own
    name = next(f"scan_{k:02d}" for k in range(6) if f"scan_{k:02d}" != scan)
    drawn(project, "corrected", name, np.zeros((150, 110), np.uint8))
    ran = stages_of(workbench("run", project, "--to", "fuse"))
    assert [ran[s]["action"] for s in ("mask", "register", "fuse")] == ["run"] * 3
    assert any(f"{name}: the mask keeps nothing" in text for text in ran["mask"]["warnings"])
    assert any(f"{name} has no surface" in text for text in ran["register"]["warnings"])


def test_masks_that_belong_nowhere_or_do_not_fit_stop_the_run_before_any_work(own):
    project, *_ = own
    wrong = drawn(project, "training", "skan_01", np.zeros((150, 110), np.uint8))
    error = error_of("run", project)
    assert error["file"] == str(wrong)
    assert "scan_01" in error["fix"]
    wrong.unlink()
    wrong = drawn(project, "corrected", "scan_01", np.zeros((110, 150), np.uint8))
    error = error_of("run", project)
    assert (error["file"], error["expected"]) == (str(wrong), "110 × 150 pixels")


def test_marked_clutter_alone_teaches_too(own):
    project, scan, photo = own
    truth = read_mask_png(project / "truth" / "masks" / f"{scan}.png")
    grid = np.asarray(np.load(project / "work" / "ingest" / "range_maps" / f"{scan}.npz")["grid"])
    clutter = (truth == 0) & (grid >= 0)
    some = np.full(truth.shape, 255, np.uint8)
    rows, columns = np.nonzero(clutter)
    some[rows[::2], columns[::2]] = 0
    drawn(project, "training", scan, some)
    (project / "masks" / "training" / f"{photo}.png").unlink()
    workbench("run", project, "--to", "mask", "--set", "mask.training=clutter")
    assert metrics_of(project, "mask")["scans_masked_by_hand"] == 0
    wrong, missed = clutter_kept(project)
    assert wrong < 0.05
    assert missed < 0.05
    assert not list((project / "work" / "mask" / "photos").glob("*.png"))


def test_one_worker_and_two_give_the_same_masks(own):
    project, *_ = own
    before = {p: p.read_bytes() for p in (project / "work" / "mask").rglob("*.png")}
    shutil.rmtree(project / "work" / "mask")
    workbench("run", project, "--to", "mask", "--workers", "1")
    assert {p: p.read_bytes() for p in (project / "work" / "mask").rglob("*.png")} == before
