from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.render.stitch.stitch_cases import border_pairs, labelled, middles, pinhole, wall
from workbench.errors import InputError
from workbench.kernels.stitch_passes import lowest_penalties, voted
from workbench.render.stitch.scene import StitchScene
from workbench.render.stitch.stitching import StitchSettings, competition, stitched
from workbench.render.stitch.visibility import visibility

ALONE = StitchSettings(rounds=0)


def shown(scene, settings=ALONE, camera=None):
    camera = camera or pinhole()
    return stitched(scene, camera, visibility(scene, camera), settings)


def test_foreground_goes_before_background_within_epsilon_only():
    """The background is nearer and cheaper, and gives way; a wall beyond ε never shows."""
    back = labelled(wall(2.0), 0, foreground=False, penalties=0.1)
    front = labelled(wall(2.04), 1, foreground=True, penalties=2.0)
    hidden = labelled(wall(2.5), 2, foreground=True, penalties=0.0)
    assert (shown(StitchScene.of([back, front, hidden], 0.05)).label == 1).all()
    assert (shown(StitchScene.of([front, hidden, back], 0.05)).label == 1).all()
    assert (shown(StitchScene.of([back, front, hidden], 0.03)).label == 0).all()


def test_a_coarser_mesh_competes_from_further_behind():
    """It is off by as much more: of two walls as far behind, the coarse one alone is let in."""
    front = labelled(wall(2.0, cells=32), 0, foreground=False, penalties=1.0)
    fine = labelled(wall(2.1, cells=32), 1, penalties=0.0)
    coarse = labelled(wall(2.1, cells=8), 2, penalties=0.5)
    scene = StitchScene.of([front, fine, coarse], 0.06)
    # Edges are four times as long; it is let in from twice as far and no more.
    assert np.unique(scene.reach).tolist() == [1.0, 2.0]
    assert (shown(scene).label == 2).all()
    assert (shown(StitchScene.of([front, fine, coarse], 0.04)).label == 0).all()


def test_the_lower_penalty_wins_among_equals_in_rank():
    one = labelled(wall(2.0), 0, False, 1.0)
    other = labelled(wall(2.02), 1, False, 0.5)
    for meshes in ([one, other], [other, one]):
        assert (shown(StitchScene.of(meshes, 0.05)).label == 1).all()


def test_of_backgrounds_of_one_photograph_the_finer_mesh_wins():
    """Whichever comes first, and by as much penalty as their coarseness weighs."""
    fine, coarse = labelled(wall(2.0, cells=32), 0, False), labelled(wall(2.01, cells=8), 0, False)
    for meshes, finer in (([fine, coarse], 0), ([coarse, fine], 1)):
        scene = StitchScene.of(meshes, 0.05)
        assert (shown(scene).mesh == finer).all()
        # Four times as long edges, over the median, which is the fine mesh's.
        assert np.unique(scene.coarseness.round(3)).tolist() == [1.0, 4.0]
    for lead, finer in ((0.8, True), (1.0, False)):
        better = replace(coarse, penalties=coarse.penalties - np.float32(lead))
        assert (shown(StitchScene.of([fine, better], 0.05)).mesh == (0 if finer else 1)).all()


def test_positions_lie_on_the_mesh_that_won():
    scene = StitchScene.of([labelled(wall(2.0), 0, False), labelled(wall(2.04), 1)], 0.05)
    camera = pinhole()
    fragments = shown(scene, camera=camera)
    assert np.abs(fragments.position[..., 2] - 2.04).max() < 1e-6
    pixels, _ = camera.project(fragments.position.reshape(-1, 3))
    rows, columns = np.mgrid[:90, :120]
    assert np.abs(pixels - np.column_stack([columns.ravel(), rows.ravel()]) - 0.5).max() < 1e-4
    assert (fragments.mesh == 1).all()


def test_more_meshes_than_slots_leave_the_lowest_penalties():
    meshes = [labelled(wall(2.0 + 1e-3 * k), k, False, 1.0 + (k * 7 % 10)) for k in range(10)]
    scene = StitchScene.of(meshes, 0.05)
    camera = pinhole(24, 18, 20.0)
    kept = competition(scene, camera, visibility(scene, camera), StitchSettings(slots=3))
    assert kept.contested.all()
    assert (np.sort(scene.penalties[kept.triangle], axis=2) == [1.0, 2.0, 3.0]).all()
    most = competition(scene, camera, visibility(scene, camera), StitchSettings(slots=16))
    assert ((most.triangle >= 0).sum(axis=2) == 10).all()


def test_a_mesh_competes_with_its_nearest_fragment():
    """A fold of it behind, within ε, is foreground and cheaper, but hidden by the mesh itself."""
    near, fold = wall(2.0), wall(2.03)
    vertices = np.vstack([near.vertices, fold.vertices])
    triangles = np.vstack([fold.triangles + len(near.vertices), near.triangles]).astype(np.int32)
    folded = replace(near, vertices=vertices, triangles=triangles)
    behind = np.arange(len(triangles)) < len(fold.triangles)
    scene = StitchScene.of([labelled(folded, np.where(behind, 1, 0), False, 1.0 - behind)], 0.05)
    assert (shown(scene).label == 0).all()


def noisy_overlap(seed=3):
    """Two backgrounds of one wall; the better one changes from left to right, amid noise."""
    rng = np.random.default_rng(seed)
    meshes, truth = [], []
    for label, direction in ((0, 1.0), (1, -1.0)):
        mesh = wall(2.0, 2.0, 60)
        clean = 1.0 + 0.2 * direction * middles(mesh)[:, 0]
        noise = rng.normal(0.0, 0.1, len(clean))
        # Tilted a little against each other, so that both are front-most somewhere.
        vertices = mesh.vertices + np.outer(direction * 1e-3 * mesh.vertices[:, 1], [0, 0, 1])
        tilted = replace(mesh, vertices=vertices)
        meshes.append(labelled(tilted, label, False, np.maximum(clean + noise, 0)))
        truth.append(clean)
    return StitchScene.of(meshes, 0.05), np.concatenate(truth)


def test_votes_of_neighbours_join_what_penalties_tear_apart():
    """Far fewer borders than pixel by pixel or by chance, at a lower true penalty than either."""
    scene, truth = noisy_overlap()
    camera = pinhole(160, 120, 80.0)
    alone, together = shown(scene, ALONE, camera), shown(scene, StitchSettings(), camera)
    chance = replace(
        scene, penalties=np.random.default_rng(0).random(len(scene.labels)).astype(np.float32)
    )
    random = shown(chance, ALONE, camera)
    borders = [border_pairs(each.label, each.seen) for each in (together, alone, random)]
    assert borders[0] < 0.25 * borders[1] < 0.25 * borders[2]
    cost = [truth[each.triangle].mean() for each in (together, alone, random)]
    assert cost[0] < cost[1] < cost[2]
    # What was measured rises by little: its minimum is the choice pixel by pixel.
    found = [scene.penalties[each.triangle].mean() for each in (together, alone)]
    assert found[1] <= found[0] < found[1] + 0.06


def test_a_gap_between_foregrounds_takes_the_labels_at_its_sides():
    """In the gap, five pixels wide, a third label is a little cheaper and would be an island."""
    left = labelled(wall(2.0, 2.0, 40, (-1, -0.025)), 0)
    right = labelled(wall(2.0, 2.0, 40, (0.025, 1)), 1)
    behind = wall(2.001, 2.0, 40)
    x = middles(behind)[:, 0]
    fills = labelled(behind, np.where(x < 0, 0, 1), False, 1.0)
    odd = labelled(wall(2.002, 2.0, 40), 2, False, 0.95)
    scene = StitchScene.of([left, right, fills, odd], 0.01)
    camera = pinhole()
    alone, together = shown(scene, ALONE, camera), shown(scene, StitchSettings(), camera)
    assert (alone.label[:, 58:62] == 2).all()
    assert (together.label[:, :60] == 0).all()
    assert (together.label[:, 60:] == 1).all()


def slow_vote(chosen, voters, triangle, depth, labels, meshes, penalties, epsilon, radius, lw, mw):
    out = chosen.copy()
    height, width, slots = triangle.shape
    for row in range(height):
        for column in range(width):
            mine = chosen[row, column]
            if mine < 0 or triangle[row, column, 1] < 0:
                continue
            own = depth[row, column, mine]
            costs = {}
            for s in [s for s in range(slots) if triangle[row, column, s] >= 0]:
                t, votes = triangle[row, column, s], []
                for r in range(max(row - radius, 0), min(row + radius + 1, height)):
                    for c in range(max(column - radius, 0), min(column + radius + 1, width)):
                        k = voters[r, c]
                        far = max(abs(r - row), abs(c - column))
                        if far == 0 or k < 0 or abs(depth[r, c, k] - own) > epsilon * far:
                            continue
                        u = triangle[r, c, k]
                        votes.append(lw * (labels[u] != labels[t]) + mw * (meshes[u] != meshes[t]))
                if not votes:
                    costs[s] = 0.0 if s == mine else 1.0
                    continue
                costs[s] = penalties[t] + np.mean(votes)
            least = min(costs.values())
            if costs[mine] > least + 1e-12:
                out[row, column] = min(s for s in costs if costs[s] <= least + 1e-12)
    return out


@pytest.mark.parametrize("seed", range(4))
def test_the_vote_is_what_its_definition_says(seed):
    rng = np.random.default_rng(seed)
    count, shape = 40, (9, 11, 4)
    triangle = rng.integers(0, count, shape).astype(np.int32)
    filled = rng.integers(0, 5, shape[:2])
    triangle[np.arange(4) >= filled[..., None]] = -1
    depth = rng.uniform(1.0, 1.3, shape).astype(np.float32)
    labels = rng.integers(0, 3, count).astype(np.int32)
    meshes = rng.integers(0, 4, count).astype(np.int32)
    penalties = rng.random(count).astype(np.float32)
    chosen = lowest_penalties(triangle, depth, penalties)
    cheapest = np.where(triangle >= 0, penalties[triangle], np.inf)
    assert (chosen == np.where(filled > 0, cheapest.argmin(axis=2), -1)).all()
    arguments = (triangle, depth, labels, meshes, penalties, 0.1, 2, 0.4, 0.2)
    for voters in (chosen, np.where(rng.random(chosen.shape) < 0.5, chosen, -1).astype(np.int8)):
        out = voted(chosen, voters, *arguments)
        assert (out == slow_vote(chosen, voters, *arguments)).all()
        assert (out != chosen).any()


def test_triangles_without_photograph_lose_and_do_no_harm():
    """Their penalty is infinite."""
    none = labelled(wall(2.0), -1, False, np.inf)
    some = labelled(wall(2.0), 3, False, 2.9)
    for settings in (ALONE, StitchSettings()):
        alone = shown(StitchScene.of([none], 0.05), settings)
        assert (alone.label == -1).all()
        assert alone.seen.all()
    tilted = replace(some, mesh=replace(some.mesh, vertices=some.mesh.vertices - [0, 0, 1e-3]))
    assert (shown(StitchScene.of([none, tilted], 0.05), StitchSettings()).label == 3).all()


def test_epsilon_follows_the_sampling_of_the_meshes():
    fine, coarse = StitchScene.of([labelled(wall(cells=64))]), StitchScene.of([labelled(wall())])
    assert coarse.epsilon == pytest.approx(8 * fine.epsilon)
    # Of a mesh that tells no spacing the longest edges, here the diagonals, stand for it.
    assert fine.epsilon == pytest.approx(6 * np.sqrt(2) * 4.0 / 64)
    told = replace(
        labelled(wall()), spacing=np.full(len(labelled(wall()).labels), 0.25, np.float32)
    )
    assert StitchScene.of([told]).epsilon == pytest.approx(6 * 0.25)


def test_settings_have_bounds():
    for bad in ({"slots": 0}, {"slots": 128}, {"rounds": -1}, {"radius_px": 0}):
        with pytest.raises(InputError, match="bounds"):
            StitchSettings(**bad)
