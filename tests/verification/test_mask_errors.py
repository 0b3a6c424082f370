"""Errors of masks: what is missed here, and what is missed everywhere."""

import weakref

import numpy as np
import pytest

from workbench.geometry.mesh import TriangleMesh
from workbench.geometry.photo_camera import PhotoCamera
from workbench.geometry.transforms import rigid
from workbench.masking.evaluation import MaskingErrors
from workbench.verification.mask_errors import CheckedMasks, MaskedSamples, checked_scan_masks
from workbench.verification.mask_sections import MaskedKind, ShownMask, masks_section
from workbench.verification.photo_coverage import MaskedPhoto, checked_photo_masks

WALL = TriangleMesh(
    np.array([[-2.0, -2, 0], [2, -2, 0], [2, 2, 0], [-2, 2, 0]]),
    np.array([[0, 1, 2], [0, 2, 3]], np.int32),
)


def on_a_line(places, kept, clutter=()):
    """Samples of an object along x; ``clutter`` are indices."""
    away = np.isin(np.arange(len(places)), clutter)
    points = np.column_stack([places, np.zeros(len(places)), np.zeros(len(places))])
    keep = np.array(kept, bool)
    return MaskedSamples(points, ~away, away, keep, keep)


def test_a_sample_is_missed_for_good_only_where_no_other_scan_keeps_the_place():
    first = on_a_line([0.0, 1.0, 2.0, 9.0], [1, 0, 0, 1], clutter=[3])
    second = on_a_line([1.0005, 2.5, 8.0], [1, 1, 0], clutter=[2])
    found = checked_scan_masks([first, second], radius_m=0.001).final
    assert found == MaskingErrors(5, 2, 1, 2, 1)
    # Its own neighbours are no other scan's word.
    alone = checked_scan_masks([on_a_line([0.0, 0.0001], [1, 0])], radius_m=0.001).final
    assert alone.true_false_negatives == 1


def test_what_is_neither_object_nor_clutter_does_not_count():
    samples = on_a_line([0.0, 1.0, 2.0], [1, 1, 0])
    edge = np.array([False, True, True])
    neither = MaskedSamples(
        samples.places, samples.model & ~edge, samples.clutter, samples.automatic, samples.final
    )
    assert checked_scan_masks([neither], 0.1).final == MaskingErrors(1, 0, 0, 0, 0)


def camera_at(x, width=40, height=40):
    """Three metres before the wall, looking along +z, one pixel per 0.05 m."""
    return PhotoCamera("PINHOLE", width, height, (60.0, 60.0, 20.0, 20.0), rigid(
        np.eye(3), [-x, 0.0, 3.0]))  # fmt: skip


def photo(x, mask):
    truth = np.full(mask.shape, 255, np.uint8)
    return MaskedPhoto(camera_at(x), truth, np.zeros(mask.shape, bool), mask, mask)


@pytest.fixture
def keeping():
    return np.full((40, 40), 255, np.uint8)


def test_a_pixel_another_photograph_keeps_is_not_missed_for_good(keeping):
    holed = keeping.copy()
    holed[10:14, 18:25] = 0
    found = checked_photo_masks([photo(0.0, holed), photo(0.2, keeping)], WALL).final
    assert (found.false_negatives, found.true_false_negatives) == (28, 0)
    # The other one looks from 0.2 m aside, four pixels: the same hole there leaves it open.
    shifted = np.roll(holed, -4, axis=1)
    found = checked_photo_masks([photo(0.0, holed), photo(0.2, shifted)], WALL).final
    assert (found.false_negatives, found.true_false_negatives) == (56, 56)
    # What leaves the other's frame is nowhere kept.
    edge = keeping.copy()
    edge[:, :4] = 0
    found = checked_photo_masks([photo(0.0, edge), photo(0.1, keeping)], WALL).final
    assert found.true_false_negatives == 2 * 40


def test_a_photograph_that_something_stands_before_keeps_nothing_there(keeping):
    holed = keeping.copy()
    holed[10:14, 18:25] = 0
    # Half a metre before the second camera, out of the first one's sight.
    screen = np.array([[0.5, -1.0, -2.5], [1.1, -1.0, -2.5], [1.1, 1.0, -2.5], [0.5, 1, -2.5]])
    blocked = TriangleMesh(
        np.vstack([WALL.vertices, screen]), np.vstack([WALL.triangles, WALL.triangles + 4])
    )
    views = [photo(0.0, holed), photo(0.8, keeping)]
    assert checked_photo_masks(views, WALL).final.true_false_negatives == 0
    assert checked_photo_masks(views, blocked).final.true_false_negatives == 28


def test_photographs_are_held_one_after_another(keeping):
    made, alive = [], []

    class Views:
        """Seven photographs that are made when asked for."""

        def __iter__(self):
            for step in range(7):
                one = photo(0.05 * step, keeping)
                made.append(weakref.ref(one))
                alive.append(sum(known() is not None for known in made))
                yield one

    assert checked_photo_masks(Views(), WALL).final.model_samples == 7 * keeping.size
    # The one before is let go when the next has come.
    assert (len(made), max(alive)) == (14, 2)


def test_the_chapter_tells_the_numbers_of_the_tables():
    checked = CheckedMasks(MaskingErrors(9000, 200, 4, 20, 3), MaskingErrors(9000, 200, 1, 10, 2))
    picture = np.full((30, 20, 3), 90, np.uint8)
    mask = np.zeros((30, 20), np.uint8)
    mask[5:20, 5:15] = 255
    shown = [ShownMask("scan_00", picture, mask, mask), ShownMask("scan_01", picture, mask)]
    kind = MaskedKind("scans", 12, 13, 2, 0.5, shown, checked, "the simulated truth")
    blocks = masks_section([kind]).as_dict()["blocks"]
    table = next(b for b in blocks if b["kind"] == "table")
    assert table["rows"][2][1:] == [4, 2.0, 1, 0.5]
    assert table["rows"][4][1:] == [3, 1.5, 2, 1.0]
    assert "12 of 13 scans" in blocks[0]["text"]
    rows = [b for b in blocks if b["kind"] == "pictures"]
    assert [len(b["pictures"]) for b in rows] == [2, 1], "a difference only where truth is known"
