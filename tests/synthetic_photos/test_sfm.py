"""Structure from motion on the photographs alone finds the cameras that took them."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from workbench.formats.colmap import ColmapModel, read_colmap_text
from workbench.synthetic import SimulationOptions, build_scene
from workbench.synthetic.photo_options import PhotoOptions
from workbench.synthetic.photo_series import write_photos

rawpy = pytest.importorskip("rawpy")
pycolmap = pytest.importorskip("pycolmap")
cv2 = pytest.importorskip("cv2")


def developed(folder: Path, out: Path) -> Path:
    """Every photograph as an 8-bit PNG by LibRaw's defaults, without automatic brightening."""
    out.mkdir(exist_ok=True)
    for file in sorted(folder.glob("photo_*.dng")):
        with rawpy.imread(str(file)) as raw:
            picture = raw.postprocess(use_camera_wb=True, no_auto_bright=True, bright=2.0)
        cv2.imwrite(str(out / f"{file.stem}.png"), picture[..., ::-1])
    return out


def reconstruction(pictures: Path, work: Path, truth: ColmapModel) -> Any:
    """pycolmap's own pipeline; the focal length starts from EXIF's, the rest from zero."""
    work.mkdir(exist_ok=True)
    camera = truth.cameras[1]
    nominal = 50.0 * max(camera.width, camera.height) / 36.0
    reader = pycolmap.ImageReaderOptions()
    reader.camera_model = "OPENCV"
    start = [nominal, nominal, camera.width / 2, camera.height / 2, 0, 0, 0, 0]
    reader.camera_params = ",".join(map(str, start))
    database = work / "database.db"
    pycolmap.set_random_seed(0)
    pycolmap.extract_features(
        database, pictures, camera_mode=pycolmap.CameraMode.SINGLE, reader_options=reader
    )
    pycolmap.match_exhaustive(database)
    options = pycolmap.IncrementalPipelineOptions()
    models = pycolmap.incremental_mapping(database, pictures, work, options=options)
    return max(models.values(), key=lambda model: model.num_reg_images())


def similarity(source: np.ndarray, target: np.ndarray) -> tuple[float, np.ndarray, np.ndarray]:
    """Scale, rotation and shift that take points (n, 3) to others best (Umeyama 1991)."""
    a, b = source - source.mean(axis=0), target - target.mean(axis=0)
    u, s, vt = np.linalg.svd(b.T @ a)
    sign = np.diag([1.0, 1.0, np.linalg.det(u @ vt)])
    rotation = u @ sign @ vt
    scale = float((s * sign.diagonal()).sum() / (a**2).sum())
    return scale, rotation, target.mean(axis=0) - scale * rotation @ source.mean(axis=0)


def camera_errors(found: Any, truth: ColmapModel) -> dict[str, float]:
    """Differences of the cameras after the best similarity."""
    centers, true_centers, rotations, true_rotations = [], [], [], []
    for image in found.images.values():
        if not image.has_pose:
            continue
        pose = image.cam_from_world().matrix()
        true = truth.image_named(image.name.replace(".png", ".dng")).camera_from_world
        centers.append(-pose[:, :3].T @ pose[:, 3])
        true_centers.append(-true[:3, :3].T @ true[:3, 3])
        rotations.append(pose[:, :3])
        true_rotations.append(true[:3, :3])
    scale, rotation, shift = similarity(np.array(centers), np.array(true_centers))
    moved = scale * np.array(centers) @ rotation.T + shift
    cosines = [
        (np.trace(mine @ rotation.T @ other.T) - 1) / 2
        for mine, other in zip(rotations, true_rotations, strict=True)
    ]
    params = next(iter(found.cameras.values())).params
    true_params = np.array(truth.cameras[1].params)
    return {
        "placed": len(centers),
        "center_rms_m": float(np.sqrt(((moved - true_centers) ** 2).sum(axis=1).mean())),
        "rotation_max_deg": float(np.degrees(np.arccos(np.clip(cosines, -1, 1))).max()),
        "focal_relative": float(params[0] / true_params[0] - 1),
        "principal_px": float(np.linalg.norm(params[2:4] - true_params[2:4])),
        "reprojection_px": float(found.compute_mean_reprojection_error()),
        "points": float(found.num_points3D()),
    }


def residuals_of_true_cameras(found: Any, truth: ColmapModel) -> np.ndarray:
    """Reprojection residuals (n, 2), pixels, of the tracks triangulated by the true cameras."""
    camera = truth.cameras[1]
    lens = pycolmap.Camera(
        model=camera.model, width=camera.width, height=camera.height, params=np.array(camera.params)
    )
    poses = {
        number: truth.image_named(image.name.replace(".png", ".dng")).camera_from_world[:3]
        for number, image in found.images.items()
    }
    residuals = []
    for point in found.points3D.values():
        seen = [
            (poses[e.image_id], found.images[e.image_id].points2D[e.point2D_idx].xy)
            for e in point.track.elements
        ]
        rows = []
        for pose, pixel in seen:
            x, y = lens.cam_from_img(pixel.reshape(1, 2))[0]
            rows += [x * pose[2] - pose[0], y * pose[2] - pose[1]]
        flat = np.linalg.svd(np.array(rows))[2][-1]
        for pose, pixel in seen:
            in_camera = pose @ (flat / flat[3])
            residuals.append(lens.img_from_cam(in_camera.reshape(1, 3))[0] - pixel)
    return np.array(residuals)


@pytest.mark.slow
def test_every_photograph_of_the_small_statue_is_placed(tmp_path: Path) -> None:
    simulation, options = SimulationOptions(), PhotoOptions()
    write_photos(tmp_path, build_scene(simulation), simulation, options)
    truth = read_colmap_text(tmp_path / "truth" / "photos")
    pictures = developed(tmp_path / "photos", tmp_path / "developed")
    found = reconstruction(pictures, tmp_path / "sfm", truth)
    errors = camera_errors(found, truth)
    residuals = residuals_of_true_cameras(found, truth)
    print(errors, np.linalg.norm(residuals, axis=1).mean(), residuals.mean(axis=0))
    assert errors["placed"] == options.photos
    # One ring of 24 photographs bends a little; the camera is two metres away.
    assert errors["center_rms_m"] < 0.010
    assert errors["rotation_max_deg"] < 1.0
    assert abs(errors["focal_relative"]) < 0.01
    assert errors["reprojection_px"] < 0.5
    # The sharper proof: the true cameras explain the features as well as the adjusted ones.
    assert np.linalg.norm(residuals, axis=1).mean() < 1.1 * errors["reprojection_px"]
    assert np.abs(residuals.mean(axis=0)).max() < 0.03
