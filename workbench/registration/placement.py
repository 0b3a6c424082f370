"""Placing all scans in one frame by their shape alone.

Every pair of scans is tried by descriptors, verified by its samples and the free space along
the lines of sight, and then all pairs are judged together: links that close no loop with the
others are outvoted. What comes out are coarse poses, good to a few sample distances, for the
joint adjustment to refine.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from workbench.geometry.orientedscan import OrientedScan
from workbench.geometry.transforms import Matrix4, inverse, rigid
from workbench.metrics import Metric
from workbench.registration.cycles import Groups, grouped, link_weights
from workbench.registration.features import describe, keypoint_distance_m
from workbench.registration.motion_averaging import averaged, loop_error_m
from workbench.registration.pairwise import Link, PairRegistration

# Fewer samples hold no six unknowns.
_LEAST_SAMPLES = 6
# Agreed places lie within a keypoint or so of each other.
_TOLERANCE_FACTOR = 1.5
_DOUBTS_TOLD = 5
# A scan far larger than the others is compared at this many times their keypoints at most.
_LARGEST = 6


@dataclass(frozen=True)
class PlacementSettings:
    """How scans are placed.

    Attributes
    ----------
    keypoints : of a scan of median size; sets the distance of keypoints.
    candidates : motions looked at per pair.
    min_consistency : share of the samples with something to say that must agree.
    min_overlap : share of the samples of either scan that must meet the other.
    threads : pairs tried at a time; the result does not depend on it.
    """

    keypoints: int = 700
    candidates: int = 4
    min_consistency: float = 0.7
    min_overlap: float = 0.03
    threads: int = 2


@dataclass(frozen=True)
class Placement:
    """Where the scans are; falsy when they do not all hang together.

    Attributes
    ----------
    poses : world_from_scan per scan, 4×4; scans of different components share no frame.
    component : (n,) int, the group each scan was placed in.
    pairs_tried : pairs of scans looked at.
    links : verified links the poses agree with.
    rejected : verified links that contradict the others round loops.
    unconfirmed : links that carry the placement without a loop that confirms them.
    loop_error_m : largest root mean square miss of a link at the poses.
    condition : how unevenly the links hold the scans, see `Averaging`.
    keypoint_m : distance of the keypoints.
    reason : why it is falsy; empty when all went well.
    """

    poses: tuple[Matrix4, ...]
    component: NDArray[np.int64]
    pairs_tried: int
    links: tuple[Link, ...]
    rejected: tuple[Link, ...]
    unconfirmed: tuple[Link, ...]
    loop_error_m: float
    condition: float
    keypoint_m: float
    reason: str

    def __bool__(self) -> bool:
        return not self.reason

    def group_of(self, scan: int) -> list[int]:
        """The scans placed in one frame with ``scan``."""
        return [int(k) for k in np.flatnonzero(self.component == self.component[scan])]

    def largest_group(self) -> list[int]:
        """The scans of the component that holds most; of equals the first."""
        if not self.component.size:
            return []
        largest = np.bincount(self.component).argmax()
        return [int(k) for k in np.flatnonzero(self.component == largest)]

    def metrics(self) -> tuple[Metric, ...]:
        """How many pairs were tried, held and fell, for records and reports."""
        verified = len(self.links) + len(self.rejected)
        return (
            Metric("pairs_tried", self.pairs_tried, "", "Pairs of scans compared by shape."),
            Metric("pair_links_verified", verified, "", "Ways two scans fit by their samples."),
            Metric(
                "pair_links_rejected",
                len(self.rejected),
                "",
                "Of these, dropped because round loops they contradict the others.",
            ),
            Metric(
                "pair_links_unconfirmed",
                len(self.unconfirmed),
                "",
                "Links the placement rests on that no loop confirms.",
            ),
            Metric(
                "loop_error",
                self.loop_error_m,
                "m",
                "Largest miss of a link kept at the placed poses, before refinement.",
            ),
        )


def place(
    scans: Sequence[OrientedScan],
    viewpoints: Sequence[NDArray[np.float64] | None],
    names: Sequence[str],
    settings: PlacementSettings,
    known: Sequence[Matrix4 | None] | None = None,
    on_pair: Callable[[int], None] = lambda _: None,
) -> Placement:
    """Coarse poses of scans by their shape.

    Parameters
    ----------
    scans : oriented scans, each in its own frame.
    viewpoints : (3,) per scan in its own frame, metres, or None where unknown.
    names : all different; they, not the order given, decide the order of work.
    known : poses that are known beforehand; the others are placed to these scans, which keep
        their poses. Without any, the first scan by name keeps its own frame.
    on_pair : told how many pairs have been tried.

    Returns
    -------
    Placement
        Deterministic, and the same whatever order the scans are given in.

    Raises
    ------
    InputError
        A sample is not finite.
    """
    for scan, name in zip(scans, names, strict=True):
        scan.check(name)
    order = sorted(range(len(scans)), key=lambda k: names[k])
    given = [known[k] if known is not None else None for k in order]
    sorted_scans = [scans[k] for k in order]
    # Each around its own middle: far coordinates cost digits in the normal equations.
    middles = [s.points.mean(axis=0) if len(s) else np.zeros(3) for s in sorted_scans]
    shifts = [rigid(np.eye(3), middle) for middle in middles]
    local = [replace(s, points=s.points - m) for s, m in zip(sorted_scans, middles, strict=True)]
    views = [
        None if (view := viewpoints[k]) is None else view - middle
        for k, middle in zip(order, middles, strict=True)
    ]
    start = [None if p is None else p @ s for p, s in zip(given, shifts, strict=True)]
    found = _placed(local, views, [names[k] for k in order], settings, start, on_pair)
    own = [pose @ inverse(shift) for pose, shift in zip(found.poses, shifts, strict=True)]
    own = _in_known_frames(own, found.component, given)
    back = np.argsort(order)

    def renamed(links: Sequence[Link]) -> tuple[Link, ...]:
        return tuple(
            replace(
                link,
                source=order[link.source],
                target=order[link.target],
                target_from_source=shifts[link.target]
                @ link.target_from_source
                @ inverse(shifts[link.source]),
                places=link.places + middles[link.source],
            )
            for link in links
        )

    return replace(
        found,
        poses=tuple(own[k] for k in back),
        component=found.component[back],
        links=renamed(found.links),
        rejected=renamed(found.rejected),
        unconfirmed=renamed(found.unconfirmed),
    )


def _placed(
    scans: Sequence[OrientedScan],
    viewpoints: Sequence[NDArray[np.float64] | None],
    names: Sequence[str],
    settings: PlacementSettings,
    known: Sequence[Matrix4 | None],
    on_pair: Callable[[int], None],
) -> Placement:
    keypoint_m = keypoint_distance_m(scans, settings.keypoints)
    limit = _LARGEST * settings.keypoints
    keypoints = [describe(scan, keypoint_m, limit) for scan in scans]
    pairs = PairRegistration(scans, viewpoints, keypoints, keypoint_m)
    sound = [k for k, scan in enumerate(scans) if len(scan) >= _LEAST_SAMPLES]
    asked = [
        (i, j) for i in sound for j in sound if i < j and (known[i] is None or known[j] is None)
    ]
    links: list[Link] = []
    loose: list[Link] = []
    with ThreadPoolExecutor(settings.threads) as pool:
        repeats = list(pool.map(pairs.repetitions, range(len(scans))))

        def links_of(pair: tuple[int, int]) -> list[Link]:
            i, j = pair
            return pairs.links(i, j, settings.candidates, repeats[i], repeats[j])

        tried = pool.map(links_of, asked)
        for count, found in enumerate(tried, start=1):
            sure = [link for link in found if _verified(link, settings)]
            links += [link for link in sure if not link.free_motions]
            loose += [link for link in sure if link.free_motions]
            on_pair(count)
    tolerance_m = _TOLERANCE_FACTOR * keypoint_m

    def bears(group: dict[int, Matrix4], other: dict[int, Matrix4]) -> bool:
        agreeing = conflicting = 0
        for i, pose in group.items():
            for j, other_pose in other.items():
                j_from_i = inverse(other_pose) @ pose
                look = pairs.judged(i, j, j_from_i, at_a_glance=True)
                agreeing, conflicting = agreeing + look.agreeing, conflicting + look.conflicting
        return agreeing >= settings.min_consistency * (agreeing + conflicting)

    together = {k: pose for k, pose in enumerate(known) if pose is not None}
    marks = [_corners(scan) for scan in scans]
    weights = dict(zip(links, link_weights(links, len(scans)), strict=True))
    groups = grouped(links, list(weights.values()), marks, names, tolerance_m, bears, together)
    strengths = [weights[link] for link in groups.kept]
    averaging = averaged(groups.poses, groups.kept, strengths, tolerance_m)
    poses = averaging.poses
    misses = {link: loop_error_m(poses, link) for link in groups.kept}
    kept = tuple(link for link in groups.kept if misses[link] <= tolerance_m)
    return Placement(
        poses=tuple(poses),
        component=groups.component,
        pairs_tried=len(asked),
        links=kept,
        rejected=groups.rejected + tuple(k for k in groups.kept if misses[k] > tolerance_m),
        unconfirmed=groups.unconfirmed,
        loop_error_m=max((misses[link] for link in kept), default=0.0),
        condition=averaging.condition,
        keypoint_m=keypoint_m,
        reason=_reason(scans, groups, loose, names),
    )


def _verified(link: Link, settings: PlacementSettings) -> bool:
    return link.consistency >= settings.min_consistency and link.overlap >= settings.min_overlap


def _reason(
    scans: Sequence[OrientedScan], groups: Groups, loose: Sequence[Link], names: Sequence[str]
) -> str:
    """Why the scans are not all in one group; empty where they are."""
    if not groups.component.any():
        return "" if groups.component.size else "there are no scans"
    empty = [n for n, scan in zip(names, scans, strict=True) if len(scan) < _LEAST_SAMPLES]
    said = [f"no surface that can be trusted in {', '.join(empty)}"] if empty else []
    said += groups.doubts[:_DOUBTS_TOLD]
    sliding = {
        f"{names[link.source]} fits {names[link.target]}, but can slide or turn along it": None
        for link in loose
        if groups.component[link.source] != groups.component[link.target]
    }
    said += list(sliding)[:_DOUBTS_TOLD]
    if not groups.doubts and not sliding and int(groups.component.max()) > len(empty):
        said.append("no shape in common was found")
    return "; ".join(said)


def _corners(scan: OrientedScan) -> NDArray[np.float64]:
    """(8, 3) corners of the box around a scan."""
    if not len(scan):
        return np.zeros((8, 3))
    box = np.stack([scan.points.min(axis=0), scan.points.max(axis=0)])
    return np.stack(np.meshgrid(*box.T, indexing="ij"), axis=-1).reshape(8, 3)


def _in_known_frames(
    poses: Sequence[Matrix4], component: NDArray[np.int64], known: Sequence[Matrix4 | None]
) -> list[Matrix4]:
    """Every component moved as a whole to where its first scan, or first known one, stands."""
    moved = list(poses)
    for group in np.unique(component):
        members = [int(k) for k in np.flatnonzero(component == group)]
        fixed = next((k for k in members if known[k] is not None), members[0])
        stands = known[fixed]
        move = (np.eye(4) if stands is None else stands) @ inverse(poses[fixed])
        for k in members:
            pose = known[k]
            moved[k] = move @ poses[k] if pose is None else pose
        if stands is None:
            moved[fixed] = np.eye(4)
    return moved
