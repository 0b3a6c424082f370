"""What simulations of other seeds are given of what a user has drawn."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np

from workbench.project.creation import create_project
from workbench.project.project import Project
from workbench.sweeping.seeds import draw_masks_again


def project_of(folder: Path, mask: int) -> Project:
    """A project with the true masks of a scan and of a photograph, all of one value."""
    (folder / "scans").mkdir(parents=True)
    np.savetxt(folder / "scans" / "scan_00.xyz", np.eye(3))
    create_project(folder / "project", scans=[folder / "scans"])
    for name in ("masks/scan_00", "photos/object/photo_003"):
        path = folder / "project" / "truth" / f"{name}.png"
        path.parent.mkdir(parents=True)
        cv2.imwrite(str(path), np.full((4, 4), mask, np.uint8))
    return Project(folder / "project")


def test_masks_are_drawn_again_after_the_truth_of_the_other(tmp_path: Path) -> None:
    project, other = project_of(tmp_path / "a", 0), project_of(tmp_path / "b", 255)
    drawn = project.root / "masks" / "training"
    drawn.mkdir(parents=True)
    for name in ("scan_00", "photo_003", "a_name_of_my_own"):
        cv2.imwrite(str(drawn / f"{name}.png"), np.zeros((4, 4), np.uint8))
    draw_masks_again(Project(project.root), other)
    made = sorted(path.name for path in (other.root / "masks" / "training").iterdir())
    assert made == ["photo_003.png", "scan_00.png"]
    for name in made:
        assert (cv2.imread(str(other.root / "masks" / "training" / name)) == 255).all()


def test_where_nothing_is_drawn_nothing_is_drawn_again(tmp_path: Path) -> None:
    other = project_of(tmp_path / "b", 255)
    draw_masks_again(project_of(tmp_path / "a", 0), other)
    assert not (other.root / "masks").exists()
