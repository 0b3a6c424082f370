"""Calibration frames: named, found by themselves, copied, hashed."""

from __future__ import annotations

from pathlib import Path

import pytest
from PIL import Image

from workbench.errors import InputError
from workbench.project.creation import create_project
from workbench.project.project import Project


@pytest.fixture
def photos(tmp_path: Path) -> Path:
    folder = tmp_path / "photos"
    folder.mkdir()
    Image.new("RGB", (8, 8)).save(folder / "a.png")
    return folder


@pytest.fixture
def frames(tmp_path: Path) -> Path:
    folder = tmp_path / "session"
    folder.mkdir()
    Image.new("RGB", (8, 8)).save(folder / "flat.png")
    (folder / "notes.toml").write_text("")
    (folder / "readme.txt").write_text("not a frame")
    return folder


def _names(project: Project) -> list[str]:
    return [path.name for path in project.input_paths("calibration_files")]


def test_none_is_none(photos: Path, tmp_path: Path) -> None:
    project = create_project(tmp_path / "p", photos=[photos])
    assert _names(project) == []
    assert project.scene().calibration == 0
    assert "calibration" not in (project.root / "project.toml").read_text()


def test_named_frames_and_notes_are_found(photos: Path, frames: Path, tmp_path: Path) -> None:
    project = create_project(tmp_path / "p", photos=[photos], calibration=[frames])
    assert _names(project) == ["flat.png", "notes.toml"]
    assert project.scene().calibration == 2
    assert 'calibration = ["../session"]' in (project.root / "project.toml").read_text()


def test_the_projects_own_folder_is_found_unless_others_are_named(
    photos: Path, frames: Path, tmp_path: Path
) -> None:
    for name, named in (("own", ()), ("both", (frames,))):
        project = create_project(tmp_path / name, photos=[photos], calibration=named)
        (project.root / "calibration").mkdir()
        Image.new("RGB", (8, 8)).save(project.root / "calibration" / "chart.png")
        found = _names(Project(project.root))
        assert found == (["flat.png", "notes.toml"] if named else ["chart.png"])


def test_frames_are_taken_along(photos: Path, frames: Path, tmp_path: Path) -> None:
    project = create_project(tmp_path / "p", photos=[photos], calibration=[frames], copy=True)
    assert _names(project) == ["flat.png", "notes.toml"]
    assert all(
        path.is_relative_to(project.root) for path in project.input_paths("calibration_files")
    )


def test_a_canon_raw_file_brings_what_is_beside_it(tmp_path: Path) -> None:
    raw = tmp_path / "CRW_1.CRW"
    raw.write_bytes(b"raw")
    (tmp_path / "CRW_1.THM").write_bytes(b"exif")
    project = create_project(tmp_path / "p", photos=[raw], copy=True)
    (beside,) = project.input_paths("photo_sidecars")
    assert beside.read_bytes() == b"exif"
    assert beside.is_relative_to(project.root)


def test_what_is_not_there_is_told_and_no_folder_is_made(photos: Path, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no such file"):
        create_project(tmp_path / "p", photos=[photos], calibration=[tmp_path / "nowhere"])
    empty = tmp_path / "empty"
    empty.mkdir()
    with pytest.raises(InputError, match="No calibration frames"):
        create_project(tmp_path / "p", photos=[photos], calibration=[empty])
    assert not (tmp_path / "p").exists()
