"""Joint multi-view adjustment: all overlapping pairs of scans at once.

Gauss–Newton on the distances between matched samples along their mean normals, robustly
weighted, with every scan but the anchor free. Unknowns are a small rotation about the
scan's centre, multiplied by the scene's radius, and a translation, so that all are metres.
The system is solved in the basis of motions the matches see least to best; those seen no
better than noise would be keep the coarse poses they came with.

Sources: Chen and Medioni 1992 (point to plane); Bergevin et al. 1996 (all views at once);
Rusinkiewicz 2019 (symmetric objective); Gelfand et al. 2003 (stability from the spectrum).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import eigh

from workbench.errors import InputError
from workbench.geometry.orientedscan import OrientedScan
from workbench.geometry.robust import TUKEY, robust_sigma, tukey_weights
from workbench.geometry.transforms import Matrix4, apply, from_twist, nearest_rigid
from workbench.registration.correspondence import Matcher, Matches, OverlapGraph, overlap_graph
from workbench.registration.freedom import Freedom, freedom_in_words, told_apart, unconstrained

_ASKED_TWICE = 2.0
# Matching may end in a cycle of a few states. Steps that no longer shrink, this far below
# what noise does to the poses, are at rest.
_CALM_SIGMAS, _CALM_ROUNDS = 0.25, 3
# What passes for an outlier, from round to round.
_STRICTER = 0.75


@dataclass(frozen=True)
class AdjustmentSettings:
    """How the adjustment runs.

    Attributes
    ----------
    samples_per_scan : samples of a scan that ask for matches in the fine rounds.
    search_m : how far matches may lie apart at first; None takes 3 % of the scene.
    min_overlap : pairs that share less are not adjusted to each other.
    max_rounds : matching rounds at most.
    tolerance : stop when no sample moves more than this share of the sample spacing, or no
        less than before and far less than noise explains.
    """

    samples_per_scan: int = 6000
    search_m: float | None = None
    min_overlap: float = 0.05
    max_rounds: int = 40
    tolerance: float = 1e-3


@dataclass(frozen=True)
class PairResult:
    """One pair of scans after the adjustment; ``rms_m`` over the matches kept."""

    source: int
    target: int
    overlap: float
    matches: int
    rms_m: float


@dataclass(frozen=True)
class Adjustment:
    """The result; falsy when the scans do not hang together or did not converge.

    Attributes
    ----------
    poses : world_from_scan per scan, 4×4 float64.
    converged, rounds : whether and after how many matching rounds.
    graph : overlaps at the final poses.
    pairs : what each pair ended with.
    residuals_before : (m,) metres, signed, along the mean normals, at the coarse poses and
        within the first search distance.
    residuals_given, residuals_after : likewise within the last search distance, at the
        coarse and the refined poses.
    sigma_given_m, sigma_m : robust standard deviations of the last two.
    covariance : (n, 6, 6) per scan, rotation (rad) then translation (m), world axes about
        the scan's centre; zero for the anchor; only constrained directions count.
    condition : ratio of the best to the least seen share among constrained motions.
    freedoms : unconstrained motions, held at the coarse poses.
    anchor : index of the scan that keeps its coarse pose.
    reason : why it is falsy; empty when all went well.
    """

    poses: tuple[Matrix4, ...]
    converged: bool
    rounds: int
    graph: OverlapGraph
    pairs: tuple[PairResult, ...]
    residuals_before: NDArray[np.float64]
    residuals_given: NDArray[np.float64]
    residuals_after: NDArray[np.float64]
    sigma_given_m: float
    sigma_m: float
    covariance: NDArray[np.float64]
    condition: float
    freedoms: tuple[Freedom, ...]
    anchor: int
    reason: str

    def __bool__(self) -> bool:
        return not self.reason


def adjust(
    scans: Sequence[OrientedScan],
    coarse_poses: Sequence[Matrix4],
    names: Sequence[str],
    settings: AdjustmentSettings,
    on_round: Callable[[int], None] = lambda _: None,
) -> Adjustment:
    """Refine coarse poses of all scans together.

    Parameters
    ----------
    scans : oriented scans, each in its own frame.
    coarse_poses : world_from_scan per scan, good to a few per cent of the scene's size, in
        a frame whose origin is near the scene.
    names : for messages.
    on_round : told after every matching round.

    Returns
    -------
    Adjustment
        Deterministic: the same input gives the same poses.

    Raises
    ------
    InputError
        A sample or a pose is not finite.
    """
    _check(scans, coarse_poses, names)
    poses = list(coarse_poses)
    matcher = Matcher(scans, min(settings.samples_per_scan, 1500))
    spacing = float(np.median(np.concatenate([scan.spacing_m for scan in scans])))
    radius = _scene_radius(scans, poses)
    floor = 3.0 * spacing
    search = max(settings.search_m or 0.06 * radius, floor)
    graph = overlap_graph(matcher, poses, search, settings.min_overlap)
    anchor = int(np.argmax(graph.fraction.sum(axis=1)))
    fine = matcher.with_samples(settings.samples_per_scan)
    before = _residuals(_match_all(fine, graph, poses, search))
    system: _System | None = None
    coarse_phase, rounds, converged = True, 0, False
    least_moved, stalled = np.inf, 0
    # Residuals are outliers by the distance that is searched at first and by their own spread
    # at last: what a scan that is far off has to say would else be the first to go.
    leeway = search / TUKEY
    while graph.pairs and rounds < settings.max_rounds and not converged:
        found = _match_all(matcher if coarse_phase else fine, graph, poses, search)
        system = _System(found, scans, poses, anchor, radius, leeway)
        moved, sigmas = system.step(poses)
        leeway *= _STRICTER
        rounds += 1
        on_round(rounds)
        at_floor = search <= floor and leeway <= max(system.sigma_m, 0.05 * spacing)
        search = max(floor, min(0.8 * search, 4.0 * system.median_distance_m))
        if not at_floor:
            continue
        stalled = 0 if moved < 0.9 * least_moved else stalled + 1
        least_moved = min(moved, least_moved)
        at_rest = moved < (0.05 if coarse_phase else settings.tolerance) * spacing
        if at_rest or (sigmas < _CALM_SIGMAS and stalled >= _CALM_ROUNDS):
            converged, coarse_phase = not coarse_phase, False
            least_moved, stalled = np.inf, 0
    final = overlap_graph(fine, poses, floor, settings.min_overlap)
    matches = _match_all(fine, final, poses, floor)
    after = _residuals(matches)
    given = _residuals(_match_all(fine, final, coarse_poses, floor))
    reason = ""
    if not (graph.connected and final.connected):
        reason = "some scans overlap no other"
    elif not converged:
        reason = f"the poses still move after {rounds} rounds"
    covariance, condition, motions = _confidence(matches, scans, poses, anchor, radius)
    return Adjustment(
        poses=tuple(poses),
        converged=converged,
        rounds=rounds,
        graph=final,
        pairs=_pair_results(matches),
        residuals_before=before,
        residuals_given=given,
        residuals_after=after,
        sigma_given_m=robust_sigma(given),
        sigma_m=robust_sigma(after),
        covariance=covariance,
        condition=condition,
        freedoms=tuple(freedom_in_words(motion, names) for motion in motions),
        anchor=anchor,
        reason=reason,
    )


class _System:
    """The linearised problem at one set of matches."""

    def __init__(
        self,
        matches: Sequence[Matches],
        scans: Sequence[OrientedScan],
        poses: Sequence[Matrix4],
        anchor: int,
        radius: float,
        leeway_m: float = 0.0,
    ) -> None:
        self._anchor, self._radius = anchor, radius
        self._centres = np.array([apply(p, _middle(s)) for s, p in zip(scans, poses, strict=True)])
        n = len(scans)
        residuals = [match.plane_residuals() for match in matches]
        pooled = np.concatenate(residuals) if residuals else np.zeros(0)
        self.sigma_m = max(robust_sigma(pooled), 1e-9 * radius)
        self.matrix = np.zeros((6 * n, 6 * n))
        # What the matrix would be if every match held its points in all three directions.
        self._held_in_space = np.zeros((6 * n, 6 * n))
        self._gradient = np.zeros(6 * n)
        weights, angles, distances = [], [], []
        for match, residual in zip(matches, residuals, strict=True):
            weight = tukey_weights(residual, max(self.sigma_m, leeway_m))
            self._add(match, residual, weight)
            cosine = np.einsum("mi,mi->m", match.source_normals, match.target_normals)
            weights.append(weight)
            angles.append(np.arccos(np.clip(cosine, -1.0, 1.0)))
            distances.append(np.linalg.norm(match.source_points - match.target_points, axis=1))
        self._squared_angle = _weighted_mean_square(angles, weights)
        self.median_distance_m = float(np.median(np.concatenate(distances))) if distances else 0.0
        free = np.ones((n, 6), bool)
        free[anchor] = False
        self._free = np.flatnonzero(free.ravel())

    def _add(
        self, match: Matches, residual: NDArray[np.float64], weight: NDArray[np.float64]
    ) -> None:
        """Accumulate JᵀWJ, JᵀWr and the isotropic JᵀWJ of one directed pair."""
        normal = match.mean_normals()
        # The mean normal turns by half of what either scan turns, which makes the middle of
        # the two samples the lever of both; a motion common to both is then felt by neither.
        middle = 0.5 * (match.source_points + match.target_points)
        jacobian = np.empty((len(match), 12))
        motion = np.empty((3, len(match), 12))
        for column, scan, sign in ((0, match.source, 1.0), (6, match.target, -1.0)):
            lever = (middle - self._centres[scan]) / self._radius
            jacobian[:, column : column + 3] = sign * np.cross(lever, normal)
            jacobian[:, column + 3 : column + 6] = sign * normal
            for axis, unit in enumerate(np.eye(3)):
                motion[axis, :, column : column + 3] = sign * np.cross(lever, unit)
                motion[axis, :, column + 3 : column + 6] = sign * unit
        weighted = jacobian * weight[:, None]
        block, gradient = weighted.T @ jacobian, weighted.T @ residual
        index = np.r_[
            6 * match.source : 6 * match.source + 6, 6 * match.target : 6 * match.target + 6
        ]
        self.matrix[np.ix_(index, index)] += block
        self._gradient[index] += gradient
        for axis in range(3):
            self._held_in_space[np.ix_(index, index)] += (
                motion[axis] * weight[:, None]
            ).T @ motion[axis]

    def spectrum(self) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.bool_]]:
        """Seen shares, motions (columns) and which are unconstrained, over the free unknowns.

        The motions are conjugate with respect to both matrices, so each can be solved or
        held by itself.
        """
        among = np.ix_(self._free, self._free)
        space = self._held_in_space[among]
        # A scan that nothing matches would make the pencil singular; its motions come out
        # with a share of zero, which is what they are.
        ridge = 1e-6 * max(float(np.trace(space)) / max(len(space), 1), 1e-300)
        shares, motions = eigh(self.matrix[among], space + ridge * np.eye(len(space)))
        return shares, motions, unconstrained(shares, self._squared_angle)

    def step(self, poses: list[Matrix4]) -> tuple[float, float]:
        """Move the scans.

        Returns
        -------
        The largest motion of any unknown in metres, and in standard deviations of its motion.
        """
        if not len(self._free):
            return 0.0, 0.0
        shares, motions, loose = self.spectrum()
        held = motions[:, ~loose]
        inner = -(held.T @ self._gradient[self._free]) / shares[~loose]
        change = np.zeros(self.matrix.shape[0])
        change[self._free] = held @ inner
        for k, part in enumerate(change.reshape(-1, 6)):
            if k == self._anchor:
                continue
            turn = from_twist([*(part[:3] / self._radius), 0.0, 0.0, 0.0])
            centre = self._centres[k]
            about = from_twist([0, 0, 0, *(centre + part[3:])]) @ turn
            poses[k] = nearest_rigid(about @ from_twist([0, 0, 0, *(-centre)]) @ poses[k])
        sigmas = np.abs(inner) * np.sqrt(shares[~loose]) / self.sigma_m
        return float(np.abs(change).max(initial=0.0)), float(sigmas.max(initial=0.0))

    def full_vectors(self, columns: NDArray[np.float64]) -> NDArray[np.float64]:
        """Columns over the free unknowns with zeros for the anchor."""
        full = np.zeros((self.matrix.shape[0], columns.shape[1]))
        full[self._free] = columns
        return full

    def covariance(self) -> NDArray[np.float64]:
        """(n, 6, 6) σ² times the inverse over the constrained directions, rad and metres.

        Doubled, for every pair of scans is asked from both sides: most matches are there
        twice with the same two samples and the same error.
        """
        shares, motions, loose = self.spectrum()
        held = motions[:, ~loose]
        variance = (held / shares[~loose]) @ held.T * self.sigma_m**2
        full = np.zeros_like(self.matrix)
        full[np.ix_(self._free, self._free)] = _ASKED_TWICE * variance
        scale = np.array([1 / self._radius] * 3 + [1.0] * 3)
        n = len(full) // 6
        blocks = full.reshape(n, 6, n, 6)[np.arange(n), :, np.arange(n), :]
        return np.asarray(blocks * scale[:, None] * scale)


def _confidence(
    matches: Sequence[Matches],
    scans: Sequence[OrientedScan],
    poses: Sequence[Matrix4],
    anchor: int,
    radius: float,
) -> tuple[NDArray[np.float64], float, list[NDArray[np.float64]]]:
    """Covariances, condition and unconstrained motions at the final matches."""
    system = _System(matches, scans, poses, anchor, radius)
    shares, motions, loose = system.spectrum()
    firm = shares[~loose]
    condition = float(firm.max() / firm.min()) if len(firm) else 1.0
    unseen = told_apart(system.full_vectors(motions[:, loose])) if loose.any() else []
    return system.covariance(), condition, unseen


def _match_all(
    matcher: Matcher, graph: OverlapGraph, poses: Sequence[Matrix4], search_m: float
) -> list[Matches]:
    """Matches of every overlapping pair, asked from both sides so that neither is favoured."""
    return [
        matcher.match(source, target, poses, search_m)
        for i, j in graph.pairs
        for source, target in ((i, j), (j, i))
    ]


def _check(scans: Sequence[OrientedScan], poses: Sequence[Matrix4], names: Sequence[str]) -> None:
    """Raise for numbers from which no pose can come."""
    for scan, pose, name in zip(scans, poses, names, strict=True):
        scan.check(name)
        if not np.isfinite(pose).all():
            raise InputError(
                f"the pose of {name} cannot be refined",
                expected="finite numbers",
                fix="give the scan another pose, or none",
            )


def _middle(scan: OrientedScan) -> NDArray[np.float64]:
    """(3,) mean of the samples; of none, the scan's own origin."""
    return np.asarray(scan.points.mean(axis=0)) if len(scan) else np.zeros(3)


def _residuals(matches: Sequence[Matches]) -> NDArray[np.float64]:
    return np.concatenate([m.plane_residuals() for m in matches]) if matches else np.zeros(0)


def _weighted_mean_square(
    values: Sequence[NDArray[np.float64]], weights: Sequence[NDArray[np.float64]]
) -> float:
    """Over all arrays together; 0 where nothing has weight."""
    total = sum(float(w.sum()) for w in weights)
    squares = sum(float(w @ v**2) for v, w in zip(values, weights, strict=True))
    return squares / total if total > 0.0 else 0.0


def _pair_results(matches: Sequence[Matches]) -> tuple[PairResult, ...]:
    return tuple(
        PairResult(
            match.source,
            match.target,
            match.overlap,
            len(match),
            float(np.sqrt(np.mean(match.plane_residuals() ** 2))) if len(match) else 0.0,
        )
        for match in matches
    )


def _scene_radius(scans: Sequence[OrientedScan], poses: Sequence[Matrix4]) -> float:
    """Half the diagonal of the box around all scans, metres."""
    everything = np.concatenate(
        [apply(p, s.points[:: max(1, len(s) // 2000)]) for s, p in zip(scans, poses, strict=True)]
    )
    return 0.5 * float(np.linalg.norm(everything.max(axis=0) - everything.min(axis=0)))
