"""Small labelling problems, and what they cost by the plainest of means."""

from __future__ import annotations

from itertools import product

import numpy as np

from workbench.geometry.labelled_mesh import NO_PHOTO
from workbench.texturing.labelling import LabellingProblem


def problem_of(candidates, costs, edges, colors, lengths=None, smoothness=1.0) -> LabellingProblem:
    """From lists per triangle and edge; an edge has its labels' colours (s, 3) in [0, 1]."""
    starts = np.concatenate([[0], np.cumsum([len(c) for c in candidates])]).astype(np.int64)
    edge_labels = [sorted({*candidates[p], *candidates[q]}) for p, q in edges]
    rows = [colors[e][label] for e, labels in enumerate(edge_labels) for label in labels]
    samples = np.shape(rows[0])[0] if rows else 1
    return LabellingProblem(
        starts,
        np.array([label for c in candidates for label in c], np.int32),
        np.array([cost for c in costs for cost in c], float),
        np.array(edges, np.int32).reshape(-1, 2),
        np.ones(len(edges)) if lengths is None else np.asarray(lengths, float),
        np.concatenate([[0], np.cumsum([len(c) for c in edge_labels])]).astype(np.int64),
        np.array([label for c in edge_labels for label in c], np.int32),
        np.round(65535 * np.array(rows, float).reshape(-1, samples, 3)).astype(np.uint16),
        smoothness,
    )


def random_problem(
    seed, triangles=6, labels=3, extra_edges=3, smoothness=1.0, tree=False, chance=0.7
) -> LabellingProblem:
    """A connected graph, some candidates everywhere, colours of no order."""
    rng = np.random.default_rng(seed)
    candidates = []
    for _ in range(triangles):
        own = np.flatnonzero(rng.random(labels) < chance).tolist()
        candidates.append(own or [int(rng.integers(labels))])
    edges = {(int(rng.integers(max(0, t - 2), t)), t) for t in range(1, triangles)}
    while not tree and extra_edges:
        p, q = sorted(rng.choice(triangles, 2, replace=False).tolist())
        edges.add((p, q))
        extra_edges -= 1
    edges = sorted(edges)
    return problem_of(
        candidates,
        [rng.random(len(c)).tolist() for c in candidates],
        edges,
        [{label: rng.random((3, 3)) for label in range(labels)} for _ in edges],
        rng.uniform(0.2, 1.5, len(edges)),
        smoothness,
    )


def plain_energy(problem: LabellingProblem, labels) -> float:
    """Eq. 1, in loops."""
    total = 0.0
    for t, label in enumerate(labels):
        if label != NO_PHOTO:
            own = problem.labels[problem.starts[t] : problem.starts[t + 1]].tolist()
            total += problem.costs[problem.starts[t] + own.index(label)]
    for e, (p, q) in enumerate(problem.edges):
        if NO_PHOTO in (labels[p], labels[q]):
            continue
        first = problem.edge_starts[e]
        own = problem.edge_labels[first : problem.edge_starts[e + 1]].tolist()
        a, b = (
            problem.edge_colors[first + own.index(labels[t])].astype(float) / 65535 for t in (p, q)
        )
        seam = np.linalg.norm(a - b, axis=1).mean()
        total += problem.smoothness * problem.edge_lengths[e] * seam
    return float(total)


def choices(problem: LabellingProblem):
    """All labellings."""
    return product(
        *(
            problem.labels[problem.starts[t] : problem.starts[t + 1]].tolist() or [NO_PHOTO]
            for t in range(problem.triangles)
        )
    )


def least_energy(problem: LabellingProblem) -> float:
    """The best of all labellings."""
    return min(plain_energy(problem, labels) for labels in choices(problem))
