"""Seam levelling: cases with known answers, and the same least squares solved densely."""

from __future__ import annotations

import numpy as np
import pytest

from tests.texturing.scenes import camera_at, sheet, together
from workbench.errors import InputError
from workbench.geometry.labelled_mesh import NO_PHOTO, LabelledMesh
from workbench.geometry.mesh import face_normals_and_areas
from workbench.texturing.patches import patches_of
from workbench.texturing.seam_levelling import levelled
from workbench.texturing.seams import color_step, colors_along, seams_of

SHARES = np.linspace(0.0, 1.0, 5)
# So faint that known answers are met to a thousandth.
FAINT = 1e-5
CAMERA = camera_at((0, -4, 0), size=(120, 120), focal=200.0, bend=0.0)
SHEET = sheet((-1, 0, -1), (2, 0, 0), (0, 0, 2), 6)


def case(labels, mesh=SHEET, colors=None):
    """A labelled sheet, its patches and its seams; every photograph is taken from one place."""
    m = len(mesh.triangles)
    plain = np.full((len(mesh.vertices), 3), 128, np.uint8)
    mesh = mesh.with_attributes(color=plain if colors is None else colors)
    labels = np.asarray(labels, np.int32)
    labelled = LabelledMesh(mesh, labels, np.ones(m, bool), np.zeros(m, np.float32))
    patches = patches_of(labelled, dict.fromkeys(range(int(labels.max()) + 1), CAMERA))
    return labelled, patches, seams_of(labelled, patches)


def plain_picture(value) -> np.ndarray:
    picture = np.full((120, 120, 4), 255, np.uint8)
    picture[..., :3] = value
    return picture


def x_of(mesh) -> np.ndarray:
    return mesh.vertices[mesh.triangles].mean(axis=1)[:, 0]


def steps_left(found, seams, colors) -> np.ndarray:
    """(e, 2, s, 3) colours along seams with their offsets."""
    ends = found.offsets[seams.rows[:, :, None], seams.corners]
    share = SHARES[:, None]
    return colors + ends[:, :, 0, None] * (1 - share) + ends[:, :, 1, None] * share


def test_a_constant_step_is_shared_by_area_and_the_mean_stays():
    # Left third 90, the rest 117: by area, offsets of 27 · 2/3 and −27 · 1/3.
    labels = (x_of(SHEET) > -1 / 3).astype(int)
    labelled, patches, seams = case(labels)
    pictures = [plain_picture((90, 100, 110)), plain_picture((117, 100, 101))]
    colors = colors_along(seams, labelled, patches, pictures.__getitem__, SHARES)
    assert color_step(colors, seams.lengths).mean == pytest.approx(np.sqrt((729 + 81) / 3))
    found = levelled(labelled, patches, seams, colors, SHARES, anchor=FAINT)
    by_triangle = np.empty((len(labels), 3, 3))
    by_triangle[patches.triangles] = found.offsets
    np.testing.assert_allclose(by_triangle[labels == 0], [[[18, 0, -6]] * 3] * 24, atol=1e-4)
    np.testing.assert_allclose(by_triangle[labels == 1], [[[-9, 0, 3]] * 3] * 48, atol=1e-4)
    np.testing.assert_allclose(found.mean_shift, 0.0, atol=1e-5)
    assert found.shifts[0] == pytest.approx((18, 0, -6), abs=1e-4)
    assert found.shifts[1] == pytest.approx((-9, 0, 3), abs=1e-4)
    square = (324 + 36) / 3 / 3 + 2 * (81 + 9) / 3 / 3
    assert found.rms_shift == pytest.approx(np.sqrt(square), rel=1e-5)
    assert found.greatest_shift == pytest.approx(18, abs=1e-4)
    assert found.skewed_share == pytest.approx(1 / 3, abs=1e-6)


def dense(labelled, patches, seams, colors, stiffness, anchor) -> np.ndarray:
    """(m, 3, 3) offsets by the same equations, one row each, by their SVD."""
    corners = labelled.mesh.triangles[patches.triangles]
    labels = labelled.labels[patches.triangles]
    keys = sorted({(int(v), int(k)) for t, k in zip(corners, labels, strict=True) for v in t})
    number = {key: i for i, key in enumerate(keys)}
    rows, right = [], []
    ties = {
        (int(k), *sorted((int(t[i]), int(t[i - 1]))))
        for t, k in zip(corners, labels, strict=True)
        for i in range(3)
    }
    for label, a, b in ties:
        row = np.zeros(len(keys))
        row[number[a, label]], row[number[b, label]] = 1, -1
        rows.append(np.sqrt(stiffness) * row)
        right.append(np.zeros(3))
    # All triangles of the sheet are equally large: a third of one for every corner.
    for v, label in keys:
        row = np.zeros(len(keys))
        row[number[v, label]] = 1
        corners_there = ((corners == v) & (labels == label)[:, None]).sum()
        rows.append(np.sqrt(anchor * stiffness * corners_there / corners.size) * row)
        right.append(np.zeros(3))
    for e, (one, other) in enumerate(labels[seams.rows]):
        a, b = seams.ends[e]
        weight = np.sqrt(seams.lengths[e] / seams.lengths.mean() / len(SHARES))
        for s, share in enumerate(SHARES):
            row = np.zeros(len(keys))
            row[number[a, one]], row[number[b, one]] = 1 - share, share
            row[number[a, other]], row[number[b, other]] = share - 1, -share
            rows.append(weight * row)
            right.append(weight * (colors[e, 1, s] - colors[e, 0, s]))
    found = np.linalg.lstsq(np.array(rows), np.array(right), rcond=1e-10)[0]
    return np.array(
        [[found[number[v, k]] for v in t] for t, k in zip(corners, labels, strict=True)]
    )


@pytest.mark.parametrize(("stiffness", "anchor"), [(0.02, 20.0), (0.1, 1e-3), (3.0, 300.0)])
def test_offsets_are_those_of_the_dense_least_squares(stiffness, anchor):
    labels = np.random.default_rng(3).integers(0, 3, len(SHEET.triangles))
    labelled, patches, seams = case(labels)
    colors = np.random.default_rng(4).uniform(0, 255, (seams.count, 2, 5, 3)).astype(np.float32)
    found = levelled(labelled, patches, seams, colors, SHARES, stiffness, anchor)
    expected = dense(labelled, patches, seams, colors, stiffness, anchor)
    np.testing.assert_allclose(expected.mean(axis=(0, 1)), 0.0, atol=1e-3)
    np.testing.assert_allclose(found.offsets, expected, atol=1e-3)


def test_a_smooth_difference_of_brightness_vanishes_from_the_seam():
    # Beside the other photograph, one grows darker along the seam.
    labels = (x_of(SHEET) > 0).astype(int)
    labelled, patches, seams = case(labels)
    fading = plain_picture((150, 150, 150))
    fading[..., :3] = np.linspace(100, 160, 120).astype(np.uint8)[:, None, None]
    pictures = [plain_picture((130, 130, 130)), fading]
    colors = colors_along(seams, labelled, patches, pictures.__getitem__, SHARES)
    before = color_step(colors, seams.lengths)
    found = levelled(labelled, patches, seams, colors, SHARES, anchor=FAINT)
    after = color_step(steps_left(found, seams, colors), seams.lengths)
    assert before.mean > 10
    assert after.mean < 0.15 * before.mean


def test_one_photograph_is_not_touched_and_parts_are_levelled_by_themselves():
    labelled, patches, seams = case(np.zeros(len(SHEET.triangles)))
    assert seams.count == 0
    nothing = np.zeros((0, 2, 5, 3), np.float32)
    assert not levelled(labelled, patches, seams, nothing, SHARES).offsets.any()

    two = together(SHEET, sheet((3, 0, -1), (2, 0, 0), (0, 0, 2), 6))
    x = x_of(two)
    camera = camera_at((1, -8, 0), size=(160, 120), focal=200.0, bend=0.0)
    labels = np.digitize(x, [0.0, 2.0, 4.0]).astype(np.int32)
    mesh = two.with_attributes(color=np.zeros((len(two.vertices), 3), np.uint8))
    m = len(x)
    labelled = LabelledMesh(mesh, labels, np.ones(m, bool), np.zeros(m, np.float32))
    patches = patches_of(labelled, dict.fromkeys(range(4), camera))
    seams = seams_of(labelled, patches)
    pictures = [np.full((120, 160, 4), value, np.uint8) for value in (100, 110, 200, 240)]
    colors = colors_along(seams, labelled, patches, pictures.__getitem__, SHARES)
    found = levelled(labelled, patches, seams, colors, SHARES, anchor=FAINT)
    expected = {0: 5.0, 1: -5.0, 2: 20.0, 3: -20.0}
    for label, shift in found.shifts.items():
        assert shift == pytest.approx((expected[label],) * 3, abs=1e-3)


def test_every_triangle_its_own_photograph():
    # Nothing ties two photographs but seams: offsets stay within what the colours differ by.
    m = len(SHEET.triangles)
    labelled, patches, seams = case(np.arange(m))
    level = np.random.default_rng(5).uniform(50, 200, m).astype(np.float32)
    own = level[patches.triangles[seams.rows]]
    colors = np.broadcast_to(own[:, :, None, None], (seams.count, 2, 5, 3)).copy()
    found = levelled(labelled, patches, seams, colors, SHARES, anchor=FAINT)
    assert np.isfinite(found.offsets).all()
    assert color_step(steps_left(found, seams, colors), seams.lengths).mean < 1e-3
    moved = level[patches.triangles][:, None, None] + found.offsets
    np.testing.assert_allclose(moved, level.mean(), atol=1e-3)


def test_what_no_photograph_shows_follows_and_does_not_pull():
    x = x_of(SHEET)
    labels = np.where(x > 1 / 3, NO_PHOTO, (x > -1 / 3).astype(int))
    labelled, patches, seams = case(labels)
    pictures = [plain_picture(100), plain_picture(120)]
    colors = colors_along(seams, labelled, patches, pictures.__getitem__, SHARES)
    found = levelled(labelled, patches, seams, colors, SHARES, anchor=FAINT)
    assert found.shifts == {
        0: pytest.approx((10,) * 3, abs=1e-3), 1: pytest.approx((-10,) * 3, abs=1e-3),
    }  # fmt: skip
    # The vertices say 128, the levelled photograph beside them 110.
    bare = labels[patches.triangles] == NO_PHOTO
    np.testing.assert_allclose(found.offsets[bare], -18.0, atol=1e-3)
    assert found.greatest_shift == pytest.approx(10, abs=1e-3)


def test_triangles_without_area_and_broken_colours():
    mesh = type(SHEET)(SHEET.vertices.copy(), SHEET.triangles)
    mesh.vertices[24] = mesh.vertices[25]
    assert (face_normals_and_areas(mesh)[1] == 0).any()
    labels = (x_of(mesh) > 0).astype(int)
    labelled, patches, seams = case(labels, mesh)
    colors = np.zeros((seams.count, 2, 5, 3), np.float32)
    colors[:, 1] = 40
    found = levelled(labelled, patches, seams, colors, SHARES, anchor=FAINT)
    assert np.isfinite(found.offsets).all()
    assert color_step(steps_left(found, seams, colors), seams.lengths).mean < 1e-3
    colors[3, 0, 0, 0] = np.nan
    with pytest.raises(InputError, match="cannot be levelled"):
        levelled(labelled, patches, seams, colors, SHARES, anchor=FAINT)
    with pytest.raises(InputError, match="cannot be levelled"):
        levelled(labelled, patches, seams, np.nan_to_num(colors), SHARES, 0.0)


def test_color_step_by_hand():
    colors = np.zeros((3, 2, 2, 3))
    colors[0, 1] = [3, 0, 0]
    colors[1, 1, 0] = [6, 6, 6]
    found = color_step(colors, np.array([1.0, 1.0, 2.0]))
    assert found.mean == pytest.approx((np.sqrt(3) + 3) / 4)
    assert found.percentile_95 == pytest.approx(6)
    assert found.length == 4.0
    assert color_step(colors[:0], np.zeros(0)).mean == 0.0


def test_the_residual_is_that_of_the_equations():
    labels = (x_of(SHEET) > -1 / 3).astype(int)
    labelled, patches, seams = case(labels)
    colors = np.random.default_rng(0).uniform(0, 255, (seams.count, 2, 5, 3)).astype(np.float32)
    found = levelled(labelled, patches, seams, colors, SHARES)
    assert 0.0 < found.residual < 1e-10
    even = levelled(labelled, patches, seams, np.full_like(colors, 90.0), SHARES)
    assert even.residual == 0.0
