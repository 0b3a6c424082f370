"""Placing two scans to each other by their shape alone, and how far to believe it.

Candidates come from descriptors; each is brought onto the other scan and then judged by all
it should explain: samples that meet, samples that miss a surface running beside them, and
samples that hang where the other scanner saw through.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import eigh

from workbench.geometry.orientedscan import OrientedScan
from workbench.geometry.robust import robust_sigma, tukey_weights
from workbench.geometry.transforms import Matrix4, apply, from_twist, inverse, nearest_rigid, rigid
from workbench.kernels.feature_matching import closest_descriptors
from workbench.registration.consensus import Correspondences, agreed_motions
from workbench.registration.correspondence import Matcher, Matches
from workbench.registration.features import Keypoints
from workbench.registration.freedom import unconstrained
from workbench.registration.freespace import FreeSpace

_RECIPROCAL = 2
# Their compatibility fills a square table.
_CORRESPONDENCES = 2500
# A scan repeats itself where this share of its keypoints agrees on one motion among those
# most alike and this many keypoint distances apart.
_REPEATED, _REPETITION_APART, _REPETITIONS, _REPETITION_SHARE = 6, 4.0, 2, 0.08
_GLANCING_SAMPLES, _REFINING_SAMPLES, _JUDGING_SAMPLES = 200, 400, 1000
_GLANCING_ROUNDS, _ROUNDS = 6, 20
# A candidate that explains less of what it should after a first glance is not pursued.
_GLANCED = 0.6
_PLACES = 12
# Samples of one surface lie this many times their roughness apart at most.
_NOISE_FACTOR = 4.0
_LEAST_MATCHES = 12


@dataclass(frozen=True, eq=False)
class Link:
    """How one scan may lie to another.

    Attributes
    ----------
    source, target : indices of the scans, source < target.
    target_from_source : 4×4.
    overlap : the larger matched share of either scan's samples, in [0, 1].
    agreeing, conflicting : samples of both that meet the other scan's surface, and that miss
        it closely or hang in its free space.
    rms_m : of the samples that meet, along the mean normals.
    free_motions : in how many ways the source can move without leaving the target's surface.
    places : (k, 3) where they meet, spread over the overlap, in the source's frame, metres.
    """

    source: int
    target: int
    target_from_source: Matrix4
    overlap: float
    agreeing: int
    conflicting: int
    rms_m: float
    free_motions: int
    places: NDArray[np.float64]

    @property
    def consistency(self) -> float:
        """Share of the samples with something to say that agree, in [0, 1]."""
        said = self.agreeing + self.conflicting
        return self.agreeing / said if said else 0.0


class PairRegistration:
    """Finds links between scans.

    Parameters
    ----------
    scans : oriented scans, each around the origin of its own frame.
    viewpoints : (3,) per scan or None, in the same frames.
    keypoints : of every scan.
    keypoint_m : their distance.
    """

    def __init__(
        self,
        scans: Sequence[OrientedScan],
        viewpoints: Sequence[NDArray[np.float64] | None],
        keypoints: Sequence[Keypoints],
        keypoint_m: float,
    ) -> None:
        self._keypoints, self._keypoint_m = keypoints, keypoint_m
        self._refining = Matcher(scans, _REFINING_SAMPLES)
        self._glancing = self._refining.with_samples(_GLANCING_SAMPLES)
        self._judging = self._refining.with_samples(_JUDGING_SAMPLES)
        self._air = [
            None if place is None else FreeSpace(scan, place)
            for scan, place in zip(scans, viewpoints, strict=True)
        ]
        self._spacing = [float(np.median(s.spacing_m)) if len(s) else 0.0 for s in scans]
        self._roughness = [float(np.median(s.roughness_m)) if len(s) else 0.0 for s in scans]

    def correspondences(self, source: int, target: int) -> Correspondences:
        """Keypoints of either scan among the most similar of the other's to each other."""
        return self._reciprocal(source, target, _RECIPROCAL, 0.0)

    def _reciprocal(self, source: int, target: int, k: int, apart_m: float) -> Correspondences:
        a, b = self._keypoints[source], self._keypoints[target]
        k = min(k, len(a), len(b))
        if not k:
            return Correspondences(*(np.zeros((0, 3)),) * 4)
        there = closest_descriptors(a.descriptors, b.descriptors, k)
        back = closest_descriptors(b.descriptors, a.descriptors, k)
        i, j = np.repeat(np.arange(len(a)), k), there.ravel()
        mutual = (back[j] == i[:, None]).any(axis=1)
        if apart_m:
            mutual &= np.linalg.norm(a.points[i] - b.points[j], axis=1) > apart_m
        i, j = i[mutual], j[mutual]
        if len(i) > _CORRESPONDENCES:
            unlike = np.linalg.norm(a.descriptors[i] - b.descriptors[j], axis=1)
            most_alike = np.sort(np.argsort(unlike, kind="stable")[:_CORRESPONDENCES])
            i, j = i[most_alike], j[most_alike]
        return Correspondences(a.points[i], b.points[j], a.normals[i], b.normals[j])

    def repetitions(self, scan: int) -> list[Matrix4]:
        """Motions that lay part of a scan onto another part of itself, both ways each.

        Whatever fits such a scan may fit it in these other ways too.
        """
        alike = self._reciprocal(scan, scan, _REPEATED, _REPETITION_APART * self._keypoint_m)
        least = int(_REPETITION_SHARE * len(self._keypoints[scan]))
        motions = agreed_motions(alike, 1.5 * self._keypoint_m, _REPETITIONS, max(least, 6))
        found = [motion.target_from_source for motion in motions]
        return [*found, *(inverse(motion) for motion in found)]

    def links(
        self,
        source: int,
        target: int,
        wanted: int,
        source_repeats: Sequence[Matrix4] = (),
        target_repeats: Sequence[Matrix4] = (),
    ) -> list[Link]:
        """Distinct ways to lay ``source`` against ``target``, judged; best first.

        Parameters
        ----------
        wanted : candidates from descriptors to look at, at most.
        source_repeats, target_repeats : `repetitions` of either scan; every way found is
            looked at again after each of them.
        """
        found: list[Link] = []
        motions = agreed_motions(
            self.correspondences(source, target), 1.5 * self._keypoint_m, wanted
        )
        for candidate in motions:
            self._try(source, target, candidate.target_from_source, found)
        # What slides along its partner fits in endless ways as it is.
        for link in [link for link in found if not link.free_motions]:
            for repeat in source_repeats:
                self._try(source, target, link.target_from_source @ repeat, found)
            for repeat in target_repeats:
                self._try(source, target, repeat @ link.target_from_source, found)
        return sorted(found, key=lambda link: -link.agreeing * link.consistency)

    def _try(self, source: int, target: int, candidate: Matrix4, found: list[Link]) -> None:
        """Bring a candidate to rest and add it where it holds and is not there already."""
        motion = self._descended(self._glancing, source, target, candidate, _GLANCING_ROUNDS)
        if self.judged(source, target, motion, at_a_glance=True).consistency < _GLANCED:
            return
        link = self.judged(source, target, self.refined(source, target, motion))
        if len(link.places) and all(self._differ(link, other) for other in found):
            found.append(link)

    def _differ(self, link: Link, other: Link) -> bool:
        """Whether two links of the same scans lay them more than a keypoint apart."""
        gap = apply(link.target_from_source, link.places)
        gap -= apply(other.target_from_source, link.places)
        return bool(np.linalg.norm(gap, axis=1).max() > self._keypoint_m)

    def refined(self, source: int, target: int, target_from_source: Matrix4) -> Matrix4:
        """The motion brought to rest on the samples (Chen and Medioni 1992, both ways)."""
        return self._descended(self._refining, source, target, target_from_source, _ROUNDS)

    def _descended(
        self, matcher: Matcher, source: int, target: int, motion: Matrix4, rounds: int
    ) -> Matrix4:
        floor = 3.0 * max(self._spacing[source], self._spacing[target])
        search = max(2.0 * self._keypoint_m, floor)
        for _ in range(rounds):
            poses = {source: motion, target: np.eye(4)}
            there = matcher.match(source, target, poses, search)
            back = matcher.match(target, source, poses, search)
            step = _step(there, back)
            if step is None:
                return motion
            motion = nearest_rigid(step @ motion)
            at_floor, search = search <= floor, max(0.7 * search, floor)
            moved = np.abs(step - np.eye(4))
            if at_floor and moved[:3, 3].max() < 0.02 * floor and moved[:3, :3].max() < 2e-4:
                break
        return motion

    def judged(
        self, source: int, target: int, target_from_source: Matrix4, *, at_a_glance: bool = False
    ) -> Link:
        """What the samples say of a motion.

        Parameters
        ----------
        at_a_glance : ask fewer samples and bear with a motion that is not at rest yet.
        """
        matcher = self._glancing if at_a_glance else self._judging
        spacing = max(self._spacing[source], self._spacing[target])
        noise = float(np.hypot(self._roughness[source], self._roughness[target]))
        fine = float(np.clip(_NOISE_FACTOR * noise, 0.5 * spacing, 2.0 * spacing))
        wide = max(1.5 * self._keypoint_m, 4.0 * spacing)
        fine = max(fine, 0.4 * self._keypoint_m) if at_a_glance else fine
        poses = {source: target_from_source, target: np.eye(4)}
        agreeing, conflicting, overlap, squares = 0, 0, 0.0, 0.0
        places = np.zeros((0, 3))
        met = []
        for a, b in ((source, target), (target, source)):
            near = matcher.match(a, b, poses, wide)
            residual = near.plane_residuals()
            meets = np.abs(residual) < fine
            agreeing += int(meets.sum())
            conflicting += int((~meets).sum())
            squares += float(residual[meets] @ residual[meets])
            overlap = max(overlap, float(meets.sum()) / max(near.queried, 1))
            conflicting += self._in_the_air(matcher, a, b, inverse(poses[b]) @ poses[a], wide)
            places = np.concatenate([places, near.source_points[meets]])
            met.append(near)
        picked = np.linspace(0, len(places) - 1, min(len(places), _PLACES)).astype(np.int64)
        return Link(
            source,
            target,
            target_from_source,
            overlap,
            agreeing,
            conflicting,
            float(np.sqrt(squares / agreeing)) if agreeing else 0.0,
            0 if at_a_glance else _free_motions(met),
            apply(inverse(target_from_source), places[picked]),
        )

    def _in_the_air(
        self, matcher: Matcher, a: int, b: int, b_from_a: Matrix4, margin_m: float
    ) -> int:
        """How many samples of ``a`` hang where ``b`` saw through."""
        air = self._air[b]
        if air is None:
            return 0
        return int(air.violated(apply(b_from_a, matcher.asking_points(a)), margin_m).sum())


def _free_motions(met: Sequence[Matches]) -> int:
    """How many motions change the distance of matched samples no more than noise would."""
    points = np.concatenate([0.5 * (m.source_points + m.target_points) for m in met])
    normals = np.concatenate([m.mean_normals() for m in met])
    cosine = np.concatenate(
        [np.einsum("mi,mi->m", m.source_normals, m.target_normals) for m in met]
    )
    if len(points) < _LEAST_MATCHES:
        return 6
    arm = points - points.mean(axis=0)
    arm /= max(float(np.sqrt((arm**2).sum(axis=1).mean())), 1e-12)
    felt = np.concatenate([np.cross(arm, normals), normals], axis=1)
    in_space = np.zeros((6, 6))
    for axis in np.eye(3):
        motion = np.concatenate([np.cross(arm, axis), np.broadcast_to(axis, arm.shape)], axis=1)
        in_space += motion.T @ motion
    shares = eigh(felt.T @ felt, in_space + 1e-9 * len(arm) * np.eye(6), eigvals_only=True)
    angles = np.arccos(np.clip(cosine, -1.0, 1.0))
    return int(unconstrained(shares, float(np.mean(angles**2))).sum())


def _step(there: Matches, back: Matches) -> Matrix4 | None:
    """One robust Gauss–Newton step of the source; None where too little meets.

    ``there`` was asked by the source, which moves, and ``back`` by the target.
    """
    points = np.concatenate([0.5 * (m.source_points + m.target_points) for m in (there, back)])
    normals = np.concatenate([there.mean_normals(), back.mean_normals()])
    residual = np.concatenate([there.plane_residuals(), -back.plane_residuals()])
    if len(points) < _LEAST_MATCHES:
        return None
    middle = points.mean(axis=0)
    arm = points - middle
    size = max(float(np.sqrt((arm**2).sum(axis=1).mean())), 1e-12)
    weight = tukey_weights(residual, max(robust_sigma(residual), 1e-9 * size))
    jacobian = np.concatenate([np.cross(arm / size, normals), normals], axis=1)
    normal_matrix = (jacobian * weight[:, None]).T @ jacobian
    ridge = 1e-4 * float(np.trace(normal_matrix))
    change = -np.linalg.solve(normal_matrix + ridge * np.eye(6), jacobian.T @ (weight * residual))
    turn = from_twist([*(change[:3] / size), 0, 0, 0])
    return rigid(np.eye(3), middle + change[3:]) @ turn @ rigid(np.eye(3), -middle)
