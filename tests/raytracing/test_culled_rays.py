"""Culled rays meet what plain Embree's meet, bit for bit, with a part of the surface in memory."""

from __future__ import annotations

import numpy as np
import pytest

from tests.raytracing.scenes import sheet, soup, stacked, view
from workbench.geometry.mesh import TriangleMesh
from workbench.kernels.query_pairs import DIVIDED, INVISIBLE, VISIBLE, pair_is_visible
from workbench.raytracing.chunk_building import build_chunk_file
from workbench.raytracing.culled_rays import CulledRays, CullingOptions
from workbench.raytracing.embree_scene import scene_bytes
from workbench.raytracing.surface_source import MeshSource
from workbench.raytracing.visibility_front import VisibilityFront
from workbench.raytracing.whole_rays import WholeRays

SMALL = CullingOptions(smallest_tile=64, cache_parts=8, found_at_once=64)


def _casters(mesh, folder, options=SMALL, per_chunk=64):
    source = MeshSource(mesh)
    file = build_chunk_file(source, folder / "a.raychunks", triangles_per_chunk=per_chunk)
    budget = scene_bytes(len(mesh.triangles)) // 5
    return WholeRays(source), CulledRays(file, budget, options)


def _shadow_rays(rays, hits):
    """From what was met towards a light, lifted to the side that was seen."""
    met = np.isfinite(hits.distances)
    away = np.where(
        (hits.normals * rays[:, 3:]).sum(axis=1, keepdims=True) > 0, -hits.normals, hits.normals
    )
    start = rays[:, :3] + rays[:, 3:] * np.where(met, hits.distances, 0.0)[:, None] + 1e-4 * away
    light = np.array([0.83, 0.31, 0.42], np.float32)
    return np.hstack([start, np.broadcast_to(light, start.shape)])[met].astype(np.float32)


def _same(one, other):
    return (
        np.array_equal(one.distances, other.distances)
        and np.array_equal(one.triangles, other.triangles)
        and np.array_equal(one.normals, other.normals)
    )


@pytest.mark.parametrize(
    "mesh",
    [
        sheet(60),
        soup(6000, 3),
        stacked(5, 25),
        TriangleMesh(
            soup(4000, 4).vertices + np.array([4.5e6, 5.1e6, 400.0]), soup(4000, 4).triangles
        ),
    ],
    ids=["sheet", "soup", "stacked", "far from its origin"],
)
def test_hits_equal_plain_embrees_bit_for_bit_over_views_in_a_row(mesh, tmp_path):
    whole, culled = _casters(mesh, tmp_path)
    first, shadow = VisibilityFront(), VisibilityFront()
    for step in range(5):
        rays = view(96, (0.4 + 0.1 * step, -1.7, 1.3), seed=step)
        expected = whole.nearest(rays)
        assert 0.05 < np.isfinite(expected.distances).mean() < 1.0
        assert _same(culled.nearest(rays, front=first), expected)
        towards = _shadow_rays(rays, expected)
        assert np.array_equal(culled.blocked(towards, front=shadow), whole.blocked(towards))
        near = whole.nearest(towards, 0.3)
        assert _same(culled.nearest(towards, 0.3), near)
        assert np.array_equal(culled.blocked(towards, 0.3), whole.blocked(towards, 0.3))
        assert np.array_equal(np.isfinite(near.distances), whole.blocked(towards, 0.3))
    assert culled.cache.most_bytes_held <= scene_bytes(len(mesh.triangles)) // 5 + scene_bytes(64)


def test_rays_aimed_at_vertices_end_there_as_near_as_plain_embrees_do(tmp_path):
    mesh = sheet(100)
    whole, culled = _casters(mesh, tmp_path)
    at = whole.frame.local(mesh.vertices)
    inner = at[(np.abs(at[:, :2]) < 0.9).all(axis=1)]
    eye = np.array([0.2, 0.1, 3.9], np.float32)
    rays = np.hstack([np.broadcast_to(eye, inner.shape), inner - eye]).astype(np.float32)
    expected, hits = whole.nearest(rays), culled.nearest(rays)
    # Which of the triangles around a vertex is met is a matter of rounding, and Embree as Open3D
    # builds it may pass between them; both casters must differ in no more than that.
    met = np.isfinite(expected.distances) & np.isfinite(hits.distances)
    assert met.mean() > 0.9
    assert (np.isfinite(expected.distances) != np.isfinite(hits.distances)).mean() < 0.01
    assert np.abs(hits.distances[met] - expected.distances[met]).max() < 1e-6
    corners = at[mesh.triangles[hits.triangles[met]]]
    off = np.abs(corners - inner[met, None]).max(axis=2).min(axis=1)
    assert np.median(off) == 0.0


def test_what_is_hidden_is_not_read(tmp_path):
    mesh = stacked(6, 30)
    options = CullingOptions(smallest_tile=64, cache_parts=8, found_at_once=16)
    _, culled = _casters(mesh, tmp_path, options)
    rays = view(64, (0.01, 0.02, 1.9), opening=0.2)
    culled.nearest(rays)
    assert culled.counts.bytes_read < 0.5 * culled.cache.file.stored_bytes(
        0, len(culled.cache.file.chunks)
    )


def test_what_was_learned_of_one_view_saves_queries_in_the_next(tmp_path):
    _, culled = _casters(sheet(60), tmp_path)
    front = VisibilityFront()
    rays = view(96, (0.4, -1.7, 1.3))
    asked = []
    for _ in range(4):
        before = culled.counts.queries
        culled.nearest(rays, front=front)
        asked.append(culled.counts.queries - before)
    assert max(asked[1:]) < 0.5 * asked[0]
    states = front.pairs[: front.count, 3]
    assert set(np.unique(states)) <= {INVISIBLE, VISIBLE, DIVIDED}


def test_invisibility_is_pulled_up_until_the_root_is_culled_at_once(tmp_path):
    _, culled = _casters(sheet(60), tmp_path)
    front = VisibilityFront()
    rays = view(64, (0.4, -1.7, 1.3))
    culled.nearest(rays, front=front)
    away = rays.copy()
    away[:, 3:] *= -1.0
    for _ in range(60):
        culled.nearest(away, front=front)
    assert front.count == 1
    assert front.pairs[0, 3] == INVISIBLE
    assert _same(culled.nearest(rays, front=front), culled.nearest(rays))


def test_aggressive_culling_loses_hits_and_invents_none(tmp_path):
    mesh = soup(6000, 5)
    whole, exact = _casters(mesh, tmp_path)
    rays = _shadow_rays(view(96, (0.4, -1.7, 1.3)), whole.nearest(view(96, (0.4, -1.7, 1.3))))
    expected = whole.blocked(rays)
    budget = scene_bytes(len(mesh.triangles)) // 5
    lost, queries = [], []
    for threshold in (0, 4, 16):
        options = CullingOptions(
            smallest_tile=64, cache_parts=8, found_at_once=64, threshold=threshold
        )
        culled = CulledRays(exact.cache.file, budget, options)
        got = culled.blocked(rays)
        assert not (got & ~expected).any()
        lost.append(int((expected & ~got).sum()))
        queries.append(culled.counts.queries)
    assert lost[0] == 0 < lost[1] < lost[2] < 0.8 * len(rays)
    assert queries[2] < queries[0]


def test_a_ray_that_runs_nowhere_or_is_not_finite_meets_nothing(tmp_path):
    _, culled = _casters(sheet(20), tmp_path)
    rays = view(16, (0.4, -1.7, 1.3))
    rays[3, 3:] = 0.0
    rays[7] = np.nan
    hits = culled.nearest(rays)
    assert np.isinf(hits.distances[[3, 7]]).all()
    assert not culled.blocked(rays)[[3, 7]].any()
    assert culled.nearest(rays[:0]).distances.shape == (0,)


def test_pairs_are_visible_where_some_ray_meets_the_box_in_float64():
    random = np.random.default_rng(6)
    rays = random.normal(size=(400, 6)).astype(np.float32)
    origins = np.ascontiguousarray(rays[:, :3].T)
    inverse = np.ascontiguousarray((1.0 / rays[:, 3:]).T)
    nearest = random.uniform(0.1, 3.0, 400).astype(np.float32)
    low = random.uniform(-1.0, 0.8, (30, 3))
    boxes = np.hstack([low, low + random.uniform(0.01, 0.2, (30, 3))]).astype(np.float32)
    children = np.full((30, 2), -1, np.int32)
    ends = np.ones(30, np.bool_)
    for node in range(30):
        with np.errstate(all="ignore"):
            cuts = (boxes[node].reshape(2, 1, 3).astype(float) - rays[:, :3]) / rays[:, 3:]
        enter = np.maximum(cuts.min(axis=0).max(axis=1), 0.0)
        met = int((enter <= np.minimum(cuts.max(axis=0).min(axis=1), nearest)).sum())
        for threshold in (met - 1, met):
            if threshold >= 0:
                seen = pair_is_visible(
                    origins, inverse, nearest, 0, 400, node, boxes, children, ends, threshold
                )
                assert seen == (met > threshold)
