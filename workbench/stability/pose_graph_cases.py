"""Graphs of scans whose links hold little, contradict each other, or hang apart."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import numpy as np
from numpy.typing import NDArray

from workbench.geometry.transforms import (
    Matrix4,
    apply,
    from_twist,
    inverse,
    rotate,
    rotation_angle_deg,
)
from workbench.registration.consensus import Correspondences, agreed_motions
from workbench.registration.cycles import grouped, link_weights
from workbench.registration.motion_averaging import averaged, loop_error_m
from workbench.registration.pairwise import Link
from workbench.stability.case import Bound, Case, Measured, Refused

_METHOD = "pose graph"
_SIGMA_M = 1e-3


def _ring(count: int, rng: np.random.Generator) -> list[Matrix4]:
    """group_from_scan of scans on a ring."""
    return [
        from_twist([*0.4 * rng.standard_normal(3), 2 * np.cos(a), 2 * np.sin(a), 0.1 * a])
        for a in np.linspace(0.0, 2 * np.pi, count, endpoint=False)
    ]


def _link(true: list[Matrix4], i: int, j: int, places: NDArray[np.float64], error: Matrix4) -> Link:
    return Link(i, j, error @ inverse(true[j]) @ true[i], 0.5, 900, 10, _SIGMA_M, 0, places)


def _error_of(rng: np.random.Generator, sigma_m: float) -> Matrix4:
    return from_twist([*sigma_m * rng.standard_normal(3), *sigma_m * rng.standard_normal(3)])


def _moved(true: list[Matrix4], rng: np.random.Generator) -> list[Matrix4]:
    return [_error_of(rng, 0.01) @ pose for pose in true]


def _averaged(
    places: NDArray[np.float64], weights: Callable[[int], float], sigma_m: float = 0.0
) -> Measured:
    """How far the places of the links miss each other at the end, metres."""
    rng = np.random.default_rng(0)
    true = _ring(6, rng)
    links = [_link(true, k, k + 1, places, _error_of(rng, sigma_m)) for k in range(5)]
    links.append(_link(true, 0, 5, places, _error_of(rng, sigma_m)))
    start = _moved(true, rng)
    averaging = averaged(start, links, [weights(k) for k in range(6)], 0.1)
    found = averaging.poses
    if not all(np.isfinite(pose).all() for pose in found):
        return Measured.nothing("poses that are no numbers")
    # What no link holds must stay: the poses may not leave the neighbourhood they were in.
    strayed = max(rotation_angle_deg(inverse(a) @ b) for a, b in zip(start, found, strict=True))
    if strayed > 15.0:
        return Measured.nothing(f"a pose turned by {strayed:.0f}°")
    told = f"condition {averaging.condition:.3g} after {averaging.rounds} rounds"
    return Measured(max(loop_error_m(found, link) for link in links), told)


def _places(kind: str) -> NDArray[np.float64]:
    rng = np.random.default_rng(1)
    return {
        "space": rng.uniform(-1, 1, (12, 3)),
        "line": np.outer(np.linspace(-1, 1, 12), [1.0, 2.0, 2.0]) / 3,
        "point": np.full((12, 3), 0.3),
    }[kind]


def _steep_weights() -> Measured:
    """Weights over twelve decades round a loop of exact links."""
    return _averaged(_places("space"), lambda k: 10.0 ** (-2.4 * k))


def _one_wrong_link() -> Measured:
    """A loop in which one link is a metre off and the other links are exact."""
    rng = np.random.default_rng(0)
    true = _ring(6, rng)
    places = _places("space")
    links = [_link(true, k, k + 1, places, np.eye(4)) for k in range(5)]
    links += [_link(true, 0, 2, places, np.eye(4)), _link(true, 2, 4, places, np.eye(4))]
    wrong = _link(true, 0, 5, places, from_twist([0.5, 0, 0, 1.0, 0, 0]))
    found = averaged(_moved(true, rng), [*links, wrong], [1.0] * 8, 0.05)
    told = f"condition {found.condition:.3g} after {found.rounds} rounds"
    return Measured(max(loop_error_m(found.poses, link) for link in links), told)


def _outvoted() -> Measured | Refused:
    """Groups of scans made of links of which a third are wrong."""
    rng = np.random.default_rng(2)
    true = _ring(6, rng)
    places = _places("space")
    pairs = [(i, j) for i in range(6) for j in range(i + 1, 6)]
    wrong = {(0, 3), (1, 4), (2, 5), (0, 2), (3, 5)}
    links = [
        _link(true, i, j, places, _error_of(rng, 0.7 if (i, j) in wrong else 1e-4))
        for i, j in pairs
    ]
    names = [f"scan_{k}" for k in range(6)]
    groups = grouped(
        links, link_weights(links, 6), [places] * 6, names, 0.05, lambda one, other: True
    )
    if groups.component.any():
        return Refused("; ".join(groups.doubts) or "the scans do not hang together")
    kept = [link for link in groups.kept if (link.source, link.target) in wrong]
    if kept:
        return Measured.nothing(f"{len(kept)} wrong links kept")
    truly = [apply(inverse(true[0]) @ pose, places) for pose in true]
    ours = [apply(inverse(groups.poses[0]) @ pose, places) for pose in groups.poses]
    return Measured(
        max(float(np.abs(a - b).max()) for a, b in zip(truly, ours, strict=True)),
        f"{len(groups.rejected)} links rejected",
    )


def _agreed(right: float) -> Measured | Refused:
    """A motion among 800 correspondences of which only some are right."""
    rng = np.random.default_rng(3)
    source, normals = rng.uniform(-1, 1, (800, 3)), rng.standard_normal((800, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    true = from_twist([0.4, -0.3, 0.8, 1.0, 2.0, 3.0])
    target, turned = apply(true, source), rotate(true, normals)
    target += _SIGMA_M * rng.standard_normal(target.shape)
    wrong = rng.random(800) >= right
    target[wrong] = rng.uniform(target.min(axis=0), target.max(axis=0), (int(wrong.sum()), 3))
    turned[wrong] = rng.permutation(turned[wrong])
    found = agreed_motions(Correspondences(source, target, normals, turned), 0.02, 1, least=12)
    if not found:
        return Refused("the correspondences agree on no motion")
    told = f"{int(found[0].inliers.sum())} of {int((~wrong).sum())} right ones agree"
    gap = apply(found[0].target_from_source, source) - apply(true, source)
    return Measured(float(np.linalg.norm(gap, axis=1).max()), told)


def _case(
    name: str,
    stiff: str,
    run: Callable[[], Measured | Refused],
    bound: Bound | None = None,
    refusal: str | None = None,
    method: str = _METHOD,
) -> Case:
    return Case(f"pose graph/{name}", method, stiff, run, bound, refusal)


_CLOSED = Bound(1e-4, "m", "exact links: what the stopping rule of 1e-4 × 0.1 m leaves, ten times")

POSE_GRAPH_CASES = (
    _case("places in line", "Every link leaves the turn about a line open.",
          partial(_averaged, _places("line"), lambda k: 1.0), _CLOSED),
    _case("places at a point", "Every link holds one point, and no turn at all.",
          partial(_averaged, _places("point"), lambda k: 1.0), _CLOSED),
    _case("weights 1 to 1e-12", "The links' information spans twelve decades.", _steep_weights,
          _CLOSED),
    _case("one wrong link", "A link is a metre off.", _one_wrong_link,
          Bound(0.005, "m", "a link 20 scales off counts 1 / 400² of one that fits")),
    _case("a third wrong", "Five of fifteen links are wrong.", _outvoted,
          Bound(1e-3, "m", "noise of the right links of 1e-4, over at most five of them")),
    _case("correspondences, 10 % right", "Nine of ten correspondences are wrong.",
          partial(_agreed, 0.1),
          Bound(0.003, "m", "noise of 1 mm over some 80 of them, at the corners of their box"),
          method="consensus of correspondences"),
    _case("correspondences, none right", "Any motion is agreed on by chance alone.",
          partial(_agreed, 0.0), refusal="no motion",
          method="consensus of correspondences"),
)  # fmt: skip
