"""Readers of oriented photographs, of picked places and of notes."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
from PIL import Image

from tests.formats.test_foreign_orientations import HEIGHT, LENS, WIDTH, agisoft, bundle, nerf
from tests.fuzz.target import Target, of_files
from workbench.formats.agisoft import read_agisoft
from workbench.formats.bundler import read_bundler, read_bundler_list
from workbench.formats.colmap import (
    ColmapCamera,
    ColmapImage,
    ColmapModel,
    ColmapPoint,
    read_colmap_text,
    write_colmap_text,
)
from workbench.formats.colmap_binary import read_colmap_binary, write_colmap_binary
from workbench.formats.nerf_transforms import read_nerf_transforms
from workbench.formats.photo_orientations import read_orientations
from workbench.orientation.picks import read_picks
from workbench.photos.calibration_notes import read_calibration_notes

_SIZES = {"a.jpg": (WIDTH, HEIGHT), "b.jpg": (WIDTH, HEIGHT)}
_TEXT = ("cameras.txt", "images.txt", "points3D.txt")
_BINARY = ("cameras.bin", "images.bin", "points3D.bin")
_PICKS = b"".join(
    b"[[points]]\nworld = [%d.0, 2.5, -3]\na = [10, 20.5]\nb = [30.0, 4]\n" % k for k in range(3)
)
_NOTES = b'flat = ["flat_1.dng"]\n[distances_m]\n"near.dng" = 1.9\n"far.dng" = 3\n'


def _model() -> ColmapModel:
    cameras = {
        1: ColmapCamera(1, "OPENCV", 64, 48, (50.0, 51.0, 32.0, 24.0, 0.1, 0.01, 1e-3, 2e-3)),
        2: ColmapCamera(2, "SIMPLE_RADIAL", 32, 24, (50.0, 16.0, 12.0, 0.1)),
    }
    poses = [np.eye(4), np.eye(4)]
    poses[1][:3, 3] = [1.0, 2.0, 3.0]
    images = {
        k + 1: ColmapImage(
            k + 1,
            poses[k],
            k + 1,
            name,
            np.array([[1.5, 2.5], [10.0, 20.0]]),
            np.array([7, -1]),
        )
        for k, name in enumerate(("a.jpg", "b.jpg"))
    }
    track = np.array([[1, 0], [2, 0]])
    point = ColmapPoint(7, np.array([1.0, 2.0, 3.0]), np.array([1, 2, 3], np.uint8), 0.5, track)
    return ColmapModel(cameras, images, {7: point})


def _colmap(
    write: Callable[[Path, ColmapModel], None], names: tuple[str, ...]
) -> Callable[[Path], list[tuple[bytes, ...]]]:
    def made(folder: Path) -> list[tuple[bytes, ...]]:
        write(folder, _model())
        return [of_files(folder, *names)]

    return made


def _photographs(folder: Path) -> tuple[Path, ...]:
    """The two photographs that orientations tell of, beside the folder."""
    photos = folder.parent / "photographs"
    if not photos.is_dir():
        photos.mkdir()
        for name in ("a.jpg", "b.jpg"):
            Image.new("RGB", (64, 48)).save(photos / name)
    return photos / "a.jpg", photos / "b.jpg"


def _oriented(name: str = ".") -> Callable[[Path], object]:
    """What is made of a file or folder for two photographs."""
    return lambda folder: read_orientations(folder / name, _photographs(folder)).photo_cameras()


ORIENTATION_TARGETS = (
    Target(
        "colmap-text",
        _TEXT,
        _colmap(write_colmap_text, _TEXT),
        (read_colmap_text, _oriented()),
    ),
    Target(
        "colmap-binary",
        _BINARY,
        _colmap(write_colmap_binary, _BINARY),
        (read_colmap_binary, _oriented()),
    ),
    Target(
        "bundler",
        ("bundle.out",),
        lambda folder: [(bundle(folder).read_bytes(),)],
        (lambda folder: read_bundler(folder / "bundle.out", ["a.jpg", "b.jpg"], _SIZES),),
        memory_multiple=512,
    ),
    Target(
        "bundler-list",
        ("list.txt",),
        lambda _: [(b"./images/a.jpg 0 532.1\nc:\\b.jpg 0 500\n",)],
        (lambda folder: read_bundler_list(folder / "list.txt"),),
    ),
    Target(
        "agisoft-xml",
        ("input.xml",),
        lambda folder: [
            (agisoft(folder, LENS).read_bytes().replace(b"DSC_1", b"a.jpg"),),
            (agisoft(folder, LENS | {"k3": 0.02, "k4": -0.03}).read_bytes(),),
        ],
        (lambda folder: read_agisoft(folder / "input.xml"), _oriented("input.xml")),
        memory_multiple=512,
    ),
    Target(
        "nerf-json",
        ("transforms.json",),
        lambda folder: [(nerf(folder).read_bytes(),)],
        (
            lambda folder: read_nerf_transforms(folder / "transforms.json", lambda name: (64, 48)),
            _oriented("transforms.json"),
        ),
    ),
    Target(
        "alignment-toml",
        ("alignment.toml",),
        lambda _: [(_PICKS,)],
        (
            lambda folder: read_picks(
                folder / "alignment.toml", {"a": Path("a.jpg"), "b": Path("b.jpg")}
            ),
        ),
    ),
    Target(
        "calibration-toml",
        ("notes.toml",),
        lambda _: [(_NOTES,)],
        (
            lambda folder: read_calibration_notes(
                [folder / "notes.toml"], ["near.dng", "far.dng", "flat_1.dng"]
            ),
        ),
    ),
)
