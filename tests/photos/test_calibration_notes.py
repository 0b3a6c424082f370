from __future__ import annotations

from pathlib import Path

import pytest

from workbench.errors import InputError
from workbench.photos.calibration_notes import CalibrationNotes, read_calibration_notes

KNOWN = ("near.dng", "far.dng", "white.nef")


def _written(folder: Path, text: str) -> list[Path]:
    path = folder / "notes.toml"
    path.write_text(text, encoding="utf-8")
    return [path]


def test_distances_and_flat_frames_are_read(tmp_path: Path) -> None:
    text = 'flat = ["white.nef"]\n[distances_m]\n"near.dng" = 1\n"far.dng" = 2.5\n'
    notes = read_calibration_notes(_written(tmp_path, text), KNOWN)
    assert notes.distances_m == {"near.dng": 1.0, "far.dng": 2.5}
    assert notes.is_flat("white.nef")
    assert not notes.is_flat("flat_00.dng"), "the notes have the word"


def test_without_notes_the_name_tells() -> None:
    assert CalibrationNotes().is_flat("Flat_00.dng")
    assert not CalibrationNotes().is_flat("linearity_00.dng")


@pytest.mark.parametrize(
    ("text", "word"),
    [
        ("distances_m = [", "cannot be read"),
        ('[distances_m]\n"near.dng" = -1', "not understood"),
        ('[distances_m]\n"near.dng" = "far"', "not understood"),
        ('[distance]\n"near.dng" = 1', "not understood"),
        ('flat = [["near.dng"]]', "not understood"),
        ('[distances_m]\n"nowhere.dng" = 1', "not there"),
        ('flat = ["nowhere.dng"]', "not there"),
    ],
)
def test_mistakes_are_told(tmp_path: Path, text: str, word: str) -> None:
    with pytest.raises(InputError, match=word):
        read_calibration_notes(_written(tmp_path, text), KNOWN)
