from __future__ import annotations

import numpy as np
import pytest
from bodies import divided_box, joined, sphere_samples, without

from workbench.geometry.mesh import TriangleMesh
from workbench.geometry.samples import Samples
from workbench.surface.provenance import (
    INFILLED,
    MEASURED,
    measured_area_share,
    near_samples,
    support_of,
    without_unmeasured_pieces,
)
from workbench.synthetic import solids

BALL = solids.geodesic_sphere((0, 0, 0), 1.0, 5)


@pytest.mark.parametrize("n", [1500, 6000])
def test_a_hole_of_known_size_is_infilled_and_the_rest_measured(n: int) -> None:
    samples = sphere_samples(n)
    hole_rad = 0.4
    holed = without(samples, samples.points[:, 2] > np.cos(hole_rad))
    found = support_of(BALL.vertices, BALL.vertices, holed, 1.0)
    angle = np.arccos(np.clip(BALL.vertices[:, 2], -1, 1))
    reach = samples.radius_m[0]
    assert (found.provenance[angle < hole_rad - 1.1 * reach] == INFILLED).all()
    assert (found.provenance[angle > hole_rad] == MEASURED).all()
    # To the edge of the hole the distance is the arc that is left, to a spacing.
    middle = np.argmin(angle)
    assert found.distance_m[middle] == pytest.approx(2 * np.sin(hole_rad / 2), abs=reach)
    assert found.provenance.dtype == np.uint8


def test_the_reach_factor_widens_what_counts_as_measured() -> None:
    samples = sphere_samples(3000)
    holed = without(samples, samples.points[:, 2] > np.cos(0.4))
    shares = [
        (support_of(BALL.vertices, BALL.vertices, holed, f).provenance == MEASURED).mean()
        for f in (0.2, 1.0, 3.0)
    ]
    assert shares[0] < shares[1] < shares[2]


@pytest.mark.parametrize("thickness", [0.1, 0.5])
def test_the_back_of_a_thin_wall_is_not_measured_from_its_front(thickness: float) -> None:
    v, u = np.meshgrid(np.arange(20.0), np.arange(20.0), indexing="ij")
    front = np.stack([u, v, np.zeros_like(u)], axis=-1).reshape(-1, 3)
    n = len(front)
    up = np.tile([0, 0, 1.0], (n, 1))
    samples = Samples(front, up, np.full(n, 1.5), np.ones(n), np.zeros(n, np.int32))
    back = front - [0, 0, thickness]
    assert (support_of(front, up, samples, 1.0).provenance == MEASURED).all()
    assert (support_of(back, -up, samples, 1.0).provenance == INFILLED).all()


def test_a_web_above_the_samples_is_not_measured() -> None:
    samples = sphere_samples(3000)
    lifted = BALL.vertices * (1 + 0.5 * samples.radius_m[0])
    assert (support_of(lifted, BALL.vertices, samples, 1.0).provenance == INFILLED).all()


def test_fewer_samples_than_neighbours_are_enough() -> None:
    one = Samples(
        np.zeros((1, 3)), np.array([[0, 0, 1.0]]), np.ones(1), np.ones(1), np.zeros(1, np.int32)
    )
    vertices = np.array([[0.5, 0, 0], [2.0, 0, 0]])
    found = support_of(vertices, np.tile([0, 0, 1.0], (2, 1)), one, 1.0)
    assert found.provenance.tolist() == [MEASURED, INFILLED]
    assert found.distance_m.tolist() == [0.5, 2.0]


def test_pieces_without_a_measured_vertex_are_found() -> None:
    cubes = joined(divided_box(0, 1, 2), divided_box(2, 3, 2), divided_box(4, 5, 2))
    provenance = np.full(len(cubes.vertices), INFILLED, np.uint8)
    provenance[cubes.vertices[:, 0] == 0] = MEASURED
    provenance[np.flatnonzero(cubes.vertices[:, 0] > 3.5)[0]] = MEASURED
    keep, pieces = without_unmeasured_pieces(cubes, provenance)
    assert pieces == 1
    x = cubes.vertices[cubes.triangles].mean(axis=1)[:, 0]
    assert np.array_equal(keep, (x < 1.5) | (x > 3.5))
    keep, pieces = without_unmeasured_pieces(cubes, np.full_like(provenance, MEASURED))
    assert keep.all()
    assert pieces == 0


def test_trimming_keeps_what_is_wholly_near_the_samples() -> None:
    cube = divided_box(0, 1, 4)
    near = near_samples(cube, cube.vertices[:, 0], 0.3)
    assert near.any()
    # Nothing reaches out further.
    assert np.array_equal(near, cube.vertices[cube.triangles][:, :, 0].max(axis=1) <= 0.3)


def test_the_measured_area_counts_corners() -> None:
    cube = divided_box(0, 1, 4)
    lower = np.where(cube.vertices[:, 2] <= 0.5, MEASURED, INFILLED).astype(np.uint8)
    share = measured_area_share(cube.with_attributes(provenance=lower))
    # Bottom and half of four sides, and half of the ring of squares above the middle.
    assert share == pytest.approx((1 + 4 * 0.5 + 4 * 0.25 * 0.5) / 6, abs=1e-12)
    flat = TriangleMesh(np.zeros_like(cube.vertices), cube.triangles, {"provenance": lower})
    assert measured_area_share(flat) == 0.0
