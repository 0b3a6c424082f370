"""Bundler's, Agisoft's and NeRF's cameras: known points land where their own formulas say."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from workbench.errors import InputError
from workbench.formats.agisoft import read_agisoft
from workbench.formats.bundler import read_bundler
from workbench.formats.colmap import ColmapModel
from workbench.formats.nerf_transforms import read_nerf_transforms
from workbench.geometry.photo_camera import PhotoCamera

WIDTH, HEIGHT = 640, 480
# A camera at CENTER in the world; columns of TURN are its axes right, down and forward.
TURN = Rotation.from_euler("xyz", [100, 20, -30], degrees=True).as_matrix()
CENTER = np.array([3.0, -2.0, 1.0])
POINTS = CENTER + (
    np.random.default_rng(2).uniform([-2, -1.5, 4], [2, 1.5, 8], size=(20, 3)) @ TURN.T
)


def normalised() -> tuple[np.ndarray, np.ndarray]:
    """Slopes to the right and down of the rays to POINTS, from first principles."""
    seen = (POINTS - CENTER) @ TURN
    return seen[:, 0] / seen[:, 2], seen[:, 1] / seen[:, 2]


def projected(model: ColmapModel, name: str, points: np.ndarray = POINTS) -> np.ndarray:
    return model.photo_cameras()[name].project(points)[0]


# Bundler --------------------------------------------------------------------------------------

F, K1, K2 = 500.0, -0.05, 0.01


def bundle(tmp_path: Path) -> Path:
    # Bundler's camera has y up and looks along −z.
    rotation = np.diag([1.0, -1.0, -1.0]) @ TURN.T
    shift = -rotation @ CENTER
    lines = ["# Bundle file v0.3", "2 2", "0 0 0", *["0 0 0"] * 4, f"{F} {K1} {K2}"]
    lines += [" ".join(map(repr, row.tolist())) for row in [*rotation, shift]]
    for point, (u, v) in zip(POINTS[:2], bundler_pixels()[:2], strict=True):
        lines += [" ".join(map(repr, point.tolist())), "10 20 30", f"2 0 5 1 1 1 7 {u} {v}"]
    (tmp_path / "bundle.out").write_text("\n".join(lines) + "\n")
    return tmp_path / "bundle.out"


def bundler_pixels() -> np.ndarray:
    """By the manual: from the middle of the picture, y up."""
    x, y = normalised()
    p = np.column_stack([x, -y])
    r2 = (p**2).sum(axis=1, keepdims=True)
    return F * (1 + K1 * r2 + K2 * r2**2) * p


def test_bundler(tmp_path: Path) -> None:
    sizes = {"a.jpg": (WIDTH, HEIGHT), "b.jpg": (WIDTH, HEIGHT)}
    model = read_bundler(bundle(tmp_path), ["a.jpg", "b.jpg"], sizes)
    # The first has a focal length of zero: Bundler could not place it.
    assert [image.name for image in model.images.values()] == ["b.jpg"]
    expected = bundler_pixels() * [1, -1] + [WIDTH / 2, HEIGHT / 2]
    np.testing.assert_allclose(projected(model, "b"), expected, atol=1e-9)
    image = model.images[2]
    np.testing.assert_allclose(image.points2d, expected[:2], atol=1e-9)
    assert image.point3d_ids.tolist() == [1, 2]
    assert model.points[2].track.tolist() == [[2, 1]]
    np.testing.assert_array_equal(model.points[1].rgb, [10, 20, 30])


def test_a_bundle_file_cut_anywhere_is_refused(tmp_path: Path) -> None:
    path = bundle(tmp_path)
    whole = path.read_text().rstrip()
    names, sizes = ["a", "b"], {"b": (WIDTH, HEIGHT)}
    words = [place for place, letter in enumerate(whole) if letter.isspace()]
    for length in words:
        path.write_text(whole[:length])
        with pytest.raises(InputError, match=r"bundle\.out"):
            read_bundler(path, names, sizes)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("v0.3", "v0.2", "version 0.3"),
        ("2 2\n", "3 2\n", "does not go with"),
        ("2 2\n", "2 2.5\n", "number of things"),
        ("2 2\n", "2 -1\n", "number of things"),
        ("500.0", "nan", "finite"),
        ("500.0", "-500", "a rotation and a focal length"),
        ("500.0", "f", "numbers"),
        ("10 20 30", "10 20 300", "colours"),
        ("2 0 5 1 1", "2 9 5 1 1", "camera's number"),
    ],
)
def test_damage_to_a_bundle_file_is_named(tmp_path: Path, old: str, new: str, message: str) -> None:
    path = bundle(tmp_path)
    path.write_text(path.read_text().replace(old, new, 1))
    with pytest.raises(InputError, match=message):
        read_bundler(path, ["a", "b"], {"a": (9, 9), "b": (WIDTH, HEIGHT)})


# Agisoft --------------------------------------------------------------------------------------

SCALE = 0.25
CHUNK_TURN = Rotation.from_euler("xyz", [5, -40, 70], degrees=True).as_matrix()
CHUNK_SHIFT = np.array([100.0, 200.0, 300.0])
LENS = {
    "f": 800.0,
    "cx": 3.5,
    "cy": -2.25,
    "b1": 1.5,
    "k1": -0.1,
    "k2": 0.05,
    "p1": 1e-3,
    "p2": -2e-3,
}


def agisoft(tmp_path: Path, lens: dict[str, float], sensor: str = 'type="frame"') -> Path:
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = TURN, CENTER
    terms = "".join(f"<{key}>{value!r}</{key}>" for key, value in lens.items())

    def numbers(array: np.ndarray) -> str:
        return " ".join(map(repr, np.ravel(array).tolist()))

    (tmp_path / "cameras.xml").write_text(
        f"""<?xml version="1.0" encoding="UTF-8"?>
<document version="1.5.0"><chunk label="Chunk 1" enabled="true">
 <sensors next_id="2"><sensor id="1" label="x" {sensor}>
  <resolution width="{WIDTH}" height="{HEIGHT}"/>
  <calibration type="frame" class="initial"><f>1</f></calibration>
  <calibration type="frame" class="adjusted">
   <resolution width="{WIDTH}" height="{HEIGHT}"/>{terms}</calibration></sensor></sensors>
 <cameras next_id="3">
  <camera id="0" sensor_id="1" label="lost"/>
  <group id="0" label="g"><camera id="1" sensor_id="1" label="DSC_1">
   <transform>{numbers(matrix)}</transform></camera></group>
 </cameras>
 <transform><rotation locked="false">{numbers(CHUNK_TURN)}</rotation>
  <translation>{numbers(CHUNK_SHIFT)}</translation><scale>{SCALE!r}</scale></transform>
</chunk></document>"""
    )
    return tmp_path / "cameras.xml"


def agisoft_pixels(lens: dict[str, float]) -> np.ndarray:
    """By the manual's formula, term by term."""
    x, y = normalised()
    t = dict.fromkeys(("k3", "k4", "b2"), 0.0) | lens
    r = np.hypot(x, y)
    bend = 1 + t["k1"] * r**2 + t["k2"] * r**4 + t["k3"] * r**6 + t["k4"] * r**8
    xp = x * bend + (t["p1"] * (r**2 + 2 * x**2) + 2 * t["p2"] * x * y)
    yp = y * bend + (t["p2"] * (r**2 + 2 * y**2) + 2 * t["p1"] * x * y)
    u = WIDTH * 0.5 + t["cx"] + xp * t["f"] + xp * t["b1"] + yp * t["b2"]
    return np.column_stack([u, HEIGHT * 0.5 + t["cy"] + yp * t["f"]])


WORLD_POINTS = SCALE * POINTS @ CHUNK_TURN.T + CHUNK_SHIFT


@pytest.mark.parametrize(
    ("more", "model_name", "tolerance"),
    [
        ({}, "OPENCV", 1e-9),
        ({"k3": 0.2}, "FULL_OPENCV", 1e-9),
        ({"k3": 0.02, "k4": -0.03}, "FULL_OPENCV", 0.05),
        ({"b2": 0.3}, "FULL_OPENCV", 0.25),
    ],
)
def test_agisoft(tmp_path: Path, more: dict[str, float], model_name: str, tolerance: float) -> None:
    model = read_agisoft(agisoft(tmp_path, LENS | more))
    assert [image.name for image in model.images.values()] == ["DSC_1"]
    assert model.cameras[2].model == model_name
    pixels = projected(model, "DSC_1", WORLD_POINTS)
    np.testing.assert_allclose(pixels, agisoft_pixels(LENS | more), atol=tolerance)
    center = model.photo_cameras()["DSC_1"].center
    np.testing.assert_allclose(center, SCALE * CHUNK_TURN @ CENTER + CHUNK_SHIFT, atol=1e-9)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("<f>800.0</f>", "<f>nan</f>", "finite"),
        ("<f>800.0</f>", "", "not positive"),
        ("<f>800.0</f>", "<fx>800.0</fx>", "PhotoScan before"),
        ('type="frame">', 'type="fisheye">', "fisheye"),
        ("<scale>0.25", "<scale>-1", "scale"),
        ('sensor_id="1" label="DSC_1"', 'sensor_id="7" label="DSC_1"', "sensor that is not"),
        ('sensor_id="1" label="DSC_1"', 'label="DSC_1"', "sensor_id"),
        ("</document>", "", "no proper XML"),
        ("<transform>", "<other>", "no proper XML"),
        ("<group", '<camera label="x"><transform>1 2</transform></camera><group', "16 finite"),
        (' id="1" label="x"', ' label="x"', "id"),
        ("<document", "<!DOCTYPE d [<!ENTITY a 'aa'>]><document", "document type"),
    ],
)
def test_damage_to_agisofts_file_is_named(tmp_path: Path, old: str, new: str, message: str) -> None:
    path = agisoft(tmp_path, LENS)
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new, 1))
    with pytest.raises(InputError, match=message) as caught:
        read_agisoft(path)
    assert "cameras.xml" in str(caught.value)


@pytest.mark.parametrize(
    ("terms", "said", "cameras"),
    [
        # Twelve derivatives a step; without an end to them it took 7,132.
        ({"f": 49.0, "k2": 1e-7, "k4": -1e-8, "b2": 0.0138, "p1": 400.0}, "miss this one", 3000),
        ({"k3": 0.02, "k4": 2.0**31}, "no lens moves a pixel", 1),
        ({"b2": 1e200, "k4": 1e200}, "no lens moves a pixel", 1),
    ],
)
def test_a_lens_that_cannot_be_is_given_up_soon(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    terms: dict[str, float],
    said: str,
    cameras: int,
) -> None:
    asked = []

    def counted(*args: Any) -> PhotoCamera:
        asked.append(args)
        return PhotoCamera(*args)

    monkeypatch.setattr("workbench.formats.agisoft.PhotoCamera", counted)
    with pytest.raises(InputError, match=said):
        read_agisoft(agisoft(tmp_path, LENS | terms))
    assert len(asked) <= cameras


def test_a_lens_beyond_the_models_and_a_file_without_cameras_are_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="miss this one"):
        read_agisoft(agisoft(tmp_path, LENS | {"b2": 8.0}))
    (tmp_path / "other.xml").write_text("<a/>")
    with pytest.raises(InputError, match="One chunk"):
        read_agisoft(tmp_path / "other.xml")


def test_an_entity_bomb_is_refused_at_once(tmp_path: Path) -> None:
    bomb = "<!DOCTYPE z [<!ENTITY a0 'x'>"
    bomb += "".join(f"<!ENTITY a{k + 1} '{f'&a{k};' * 10}'>" for k in range(9))
    (tmp_path / "bomb.xml").write_text(bomb + "]><z>&a9;</z>")
    with pytest.raises(InputError, match="document type"):
        read_agisoft(tmp_path / "bomb.xml")


# NeRF -----------------------------------------------------------------------------------------


def nerf(tmp_path: Path, **changes: Any) -> Path:
    # OpenGL's camera: right, up, backward.
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = TURN * [1, -1, -1], CENTER
    frame = {"file_path": "./images/b.jpg", "transform_matrix": matrix.tolist()}
    content = {
        "fl_x": 700.0,
        "fl_y": 690.0,
        "cx": 321.5,
        "cy": 238.0,
        "w": WIDTH,
        "h": HEIGHT,
        "k1": -0.05,
        "k2": 0.02,
        "p1": 1e-3,
        "p2": -5e-4,
        "frames": [frame],
    }
    content.update({key: value for key, value in changes.items() if key != "frame"})
    frame.update(changes.get("frame", {}))
    content = {key: value for key, value in content.items() if value is not None}
    (tmp_path / "transforms.json").write_text(json.dumps(content))
    return tmp_path / "transforms.json"


def test_nerf(tmp_path: Path) -> None:
    model = read_nerf_transforms(nerf(tmp_path), lambda name: None)
    x, y = normalised()
    r2 = x * x + y * y
    bend = 1 - 0.05 * r2 + 0.02 * r2**2
    u = 321.5 + 700 * (x * bend + 2e-3 * x * y - 5e-4 * (r2 + 2 * x * x))
    v = 238.0 + 690 * (y * bend - 1e-3 * x * y + 1e-3 * (r2 + 2 * y * y))
    np.testing.assert_allclose(projected(model, "b"), np.column_stack([u, v]), atol=1e-9)


def test_nerf_with_angles_and_intrinsics_of_each_frame(tmp_path: Path) -> None:
    none = dict.fromkeys(("fl_x", "fl_y", "cx", "cy", "w", "h", "k1", "k2", "p1", "p2"))
    path = nerf(tmp_path, **none, camera_angle_x=2 * np.arctan(0.5), frame={"cx": 300.0})
    model = read_nerf_transforms(path, lambda name: (WIDTH, HEIGHT) if name == "b.jpg" else None)
    x, y = normalised()
    expected = np.column_stack([300 + WIDTH * x, HEIGHT / 2 + WIDTH * y])
    np.testing.assert_allclose(projected(model, "b"), expected, atol=1e-9)
    assert read_nerf_transforms(path, lambda name: None).images == {}


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"fl_x": None}, "no 'camera_angle_x'"),
        ({"fl_x": -1.0}, "not positive"),
        ({"fl_x": True}, "no finite number"),
        ({"fl_x": "7"}, "no finite number"),
        ({"k1": float("nan")}, "no finite number"),
        ({"w": 640.5}, "640.5"),
        ({"camera_model": "SPHERE"}, "unknown camera model"),
        ({"frames": []}, "no frames"),
        ({"frames": [3]}, "file_path"),
        ({"frame": {"transform_matrix": [[2, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0]]}}, "rigid"),
        ({"frame": {"transform_matrix": [[1, 2], [3]]}}, "frame 1"),
        ({"frame": {"transform_matrix": None}}, "frame 1"),
    ],
)
def test_damage_to_transforms_is_named(
    tmp_path: Path, changes: dict[str, Any], message: str
) -> None:
    with pytest.raises(InputError, match=message) as caught:
        read_nerf_transforms(nerf(tmp_path, **changes), lambda name: None)
    assert "transforms.json" in str(caught.value)


@pytest.mark.parametrize("text", ["", "{", "[]", "3", "[" * 100000])
def test_what_is_no_json_object_is_refused(tmp_path: Path, text: str) -> None:
    (tmp_path / "transforms.json").write_text(text)
    with pytest.raises(InputError):
        read_nerf_transforms(tmp_path / "transforms.json", lambda name: None)
