import numpy as np
import pytest
from scipy.spatial import cKDTree

from workbench.errors import InputError
from workbench.surfels.candidates import surface_candidates
from workbench.surfels.orders import exact_order, progressive_order
from workbench.surfels.painted_surface import PaintedSurface
from workbench.surfels.spacing import (
    Spacing,
    measured_spacing,
    nearest_distances,
    nearest_owner,
    spacing_distributions,
)


@pytest.fixture(scope="module")
def ball(sphere):
    points, gap = surface_candidates(PaintedSurface.of(sphere(1.0)), 256)
    return points, gap


def test_the_prefix_for_a_radius_is_the_papers_formula():
    spacing = Spacing(1000, 0.02)

    assert spacing.prefix_for(0.02) == 1000
    assert spacing.prefix_for(0.01) == 4000
    assert spacing.prefix_for(0.04) == 250
    assert spacing.prefix_for(1e9) == 1
    assert spacing.prefix_for(1e-300) > 1 << 60
    assert all(spacing.prefix_for(spacing.radius_for(p)) == p for p in range(1, 3000))
    with pytest.raises(InputError):
        spacing.prefix_for(0.0)


def test_discs_of_the_radius_cover_the_surface_at_every_prefix(ball):
    points, gap = ball
    order = exact_order(points.points, 6000)
    surfels = points.points[order.picks]

    spacing = measured_spacing(surfels, order, gap)

    # Six thousand points on a unit sphere: area of a hexagon of that spacing each, or above.
    lattice = np.sqrt(4 * np.pi / (6000 * np.sqrt(3) / 2))
    assert 0.8 * lattice < spacing.radius_for(6000) < 1.5 * lattice
    direction = np.random.default_rng(0).normal(size=(20_000, 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    for prefix in (50, 300, 1000, 2500, 6000):
        apart, _ = cKDTree(surfels[:prefix]).query(direction)
        assert 0.5 * spacing.radius_for(prefix) < apart.max() < spacing.radius_for(prefix)


def test_the_median_alone_is_the_papers_r_m_where_nothing_is_farther(ball):
    points, _ = ball
    order = exact_order(points.points, 1000)
    surfels = points.points[order.picks]

    spacing = measured_spacing(surfels, order, 0.0)

    assert spacing.prefix == 1000
    assert spacing.distance == pytest.approx(np.median(nearest_distances(surfels)))
    assert order.rest < spacing.distance < 1.2 * order.rest


def test_owners_are_the_nearest_picks(ball):
    points, _ = ball
    order = exact_order(points.points, 500)
    rounds = nearest_owner(points.points, progressive_order(points.points, 500))

    for one in (order, rounds):
        apart, owner = cKDTree(points.points[one.picks]).query(points.points)
        mine = np.linalg.norm(points.points - points.points[one.picks[one.owner]], axis=1)
        np.testing.assert_allclose(mine, apart, rtol=1e-5, atol=1e-7)
        assert (one.owner == owner).mean() > 0.999
        assert one.rest == pytest.approx(apart.max(), rel=1e-5)


def test_distributions_rank_the_orders_as_the_paper_does(ball):
    points, _ = ball

    found = spacing_distributions(points.points, (100, 1000), normals=points.normals, opposite=0.1)

    assert list(found) == ["random", "progressive", "exact", "both sides"]
    for prefix in (100, 1000):
        random, rounds, exact, sides = (found[name][prefix] for name in found)
        assert all(len(values) == prefix for values in (random, rounds, exact, sides))
        assert random.min() < 0.2 * exact.min() < exact.min()
        assert 0.6 * exact.min() < rounds.min() < exact.min()
        assert np.median(random) < np.median(rounds) < np.median(exact)
        # The exact order has a clear lower bound; its distances are alike.
        assert np.median(exact) < 1.25 * exact.min()
        # A ball has no thin walls.
        assert np.median(sides) == pytest.approx(np.median(exact), rel=0.03)


def test_points_alone_have_no_nearest():
    assert nearest_distances(np.zeros((1, 3))).tolist() == [np.inf]
    assert nearest_distances(np.zeros((0, 3))).tolist() == []
    np.testing.assert_array_equal(nearest_distances(np.array([[0, 0, 0], [3, 4, 0.0]])), [5, 5])
