"""Telling right links between scans from wrong ones: round every loop they must close.

Groups of scans grow together, each time along the motion most of the links between two groups
agree on. A link counts as much as its own samples and those of every triangle it closes, so
that wrong links, which agree with no others, are outvoted however good they look alone. A
merge must also bear the look of every scan of one group on every scan of the other.

Sources: Huber and Hebert 2003 (groups of range images merged under a global consistency test);
Zach et al. 2010 (loops disambiguate repeated structure).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from workbench.geometry.transforms import Matrix4, apply, inverse
from workbench.registration.pairwise import Link

# The least share of samples against a link that is taken for usual.
_LEAST_CONTRADICTION = 0.01
# A second way to put two groups together this close to the first makes both uncertain.
_RIVAL = 0.6


@dataclass(frozen=True)
class Groups:
    """Scans put together as far as their links reach.

    Attributes
    ----------
    poses : group_from_scan per scan.
    component : (n,) int, the group of each scan, counted from 0 in order of first scan.
    kept, rejected : links that agree with the poses, and those that contradict them.
    unconfirmed : links no loop confirms on which two groups hang together.
    doubts : sentences on merges that were not made.
    """

    poses: tuple[Matrix4, ...]
    component: NDArray[np.int64]
    kept: tuple[Link, ...]
    rejected: tuple[Link, ...]
    unconfirmed: tuple[Link, ...]
    doubts: tuple[str, ...]


def link_weights(links: Sequence[Link], scans: int) -> list[float]:
    """How much each link counts: its agreeing samples, much less where more contradict it
    than is usual with these scans.

    What is usual the best link of every scan tells. Where shapes repeat themselves, nearly all
    samples of a wrong link agree, and only the few that do not betray it.
    """
    best = [
        min(
            (1.0 - link.consistency for link in links if k in (link.source, link.target)), default=0
        )
        for k in range(scans)
    ]
    usual = float(np.median(best)) + _LEAST_CONTRADICTION if best else 1.0
    return [link.agreeing * float(np.exp(-(1.0 - link.consistency) / usual)) for link in links]


def grouped(
    links: Sequence[Link],
    weights: Sequence[float],
    marks: Sequence[NDArray[np.float64]],
    names: Sequence[str],
    tolerance_m: float,
    bears: Callable[[dict[int, Matrix4], dict[int, Matrix4]], bool],
    together: dict[int, Matrix4] | None = None,
) -> Groups:
    """Put scans together along links that agree with each other.

    Parameters
    ----------
    links : verified links; several per pair where a pair is ambiguous.
    weights : how much each counts; see `link_weights`.
    marks : (k, 3) per scan, places all round it, in its own frame.
    names : of the scans, for ``doubts``.
    tolerance_m : how far links may displace a scan's marks and still agree.
    bears : whether two groups, scan → pose in a common frame, do not contradict each other.
    together : scans whose poses are known beforehand, scan → pose; they start as one group.
    """
    return _Merging(links, weights, marks, names, tolerance_m, bears, together or {}).groups()


@dataclass(frozen=True)
class _Proposal:
    """One motion for two groups and the links that agree on it."""

    first: int
    second: int
    first_from_second: Matrix4
    links: tuple[int, ...]
    strength: float
    confirmed: bool
    rivalled: bool


class _Merging:
    def __init__(
        self,
        links: Sequence[Link],
        weights: Sequence[float],
        marks: Sequence[NDArray[np.float64]],
        names: Sequence[str],
        tolerance_m: float,
        bears: Callable[[dict[int, Matrix4], dict[int, Matrix4]], bool],
        together: dict[int, Matrix4],
    ) -> None:
        self._links, self._marks, self._names = links, marks, names
        self._tolerance_m, self._bears = tolerance_m, bears
        n = len(marks)
        self._pose: list[Matrix4] = [together.get(k, np.eye(4)) for k in range(n)]
        first = min(together, default=0)
        self._group = [first if k in together else k for k in range(n)]
        self._weight = list(weights)
        self._support = self._loop_support()
        self._strength = [w + s for w, s in zip(self._weight, self._support, strict=True)]
        self._used: set[int] = set()
        self._unconfirmed: list[int] = []
        self._refused: set[tuple[int, ...]] = set()
        self._doubts: dict[tuple[int, int], str] = {}

    def groups(self) -> Groups:
        """Merge until nothing can be."""
        while (proposal := self._best()) is not None:
            moved = self._placed(proposal.second, proposal.first_from_second)
            if not self._bears(self._placed(proposal.first), moved):
                self._refused.add(proposal.links)
                continue
            self._merge(proposal)
        _, component = np.unique(self._group, return_inverse=True)
        kept = [self._agrees(link) for link in self._links]
        within = [component[link.source] == component[link.target] for link in self._links]
        return Groups(
            tuple(self._pose),
            np.asarray(component, np.int64),
            tuple(link for link, good in zip(self._links, kept, strict=True) if good),
            tuple(
                link
                for link, good, same in zip(self._links, kept, within, strict=True)
                if same and not good
            ),
            tuple(self._links[k] for k in self._unconfirmed),
            tuple(self._doubts.values()),
        )

    def _loop_support(self) -> list[float]:
        """Per link, the weight of the triangles of links it closes."""
        between: dict[tuple[int, int], list[int]] = {}
        beside: dict[int, set[int]] = {}
        for k, link in enumerate(self._links):
            between.setdefault((link.source, link.target), []).append(k)
            beside.setdefault(link.source, set()).add(link.target)
            beside.setdefault(link.target, set()).add(link.source)
        support = [0.0] * len(self._links)
        for i, j in sorted(between):
            for k in sorted(m for m in beside[i] & beside[j] if m > j):
                for a in between[i, j]:
                    for b in between[j, k]:
                        around = self._motion(b) @ self._motion(a)
                        for c in between[i, k]:
                            gap = self._apart(around, self._motion(c), self._marks[i])
                            if gap > self._tolerance_m:
                                continue
                            for one, two, three in ((a, b, c), (b, a, c), (c, a, b)):
                                support[one] += min(self._weight[two], self._weight[three])
        return support

    def _motion(self, link: int) -> Matrix4:
        return self._links[link].target_from_source

    def _apart(self, a: Matrix4, b: Matrix4, marks: NDArray[np.float64]) -> float:
        """Root mean square distance of the marks moved by either, metres."""
        gap = apply(a, marks) - apply(b, marks)
        return float(np.sqrt((gap**2).sum(axis=1).mean()))

    def _members(self, group: int) -> list[int]:
        return [k for k, g in enumerate(self._group) if g == group]

    def _placed(self, group: int, moved: Matrix4 | None = None) -> dict[int, Matrix4]:
        move = np.eye(4) if moved is None else moved
        return {k: move @ self._pose[k] for k in self._members(group)}

    def _best(self) -> _Proposal | None:
        """The strongest merge, those a loop confirms first."""
        between: dict[tuple[int, int], list[int]] = {}
        for k, link in enumerate(self._links):
            a, b = sorted((self._group[link.source], self._group[link.target]))
            if a != b:
                between.setdefault((a, b), []).append(k)
        found = []
        self._doubts = {}
        for (a, b), crossing in sorted(between.items()):
            proposal = self._proposed(a, b, crossing)
            if proposal is None:
                continue
            if proposal.rivalled:
                link = self._links[proposal.links[0]]
                one, other = self._names[link.source], self._names[link.target]
                self._doubts[a, b] = f"{one} fits {other} in more than one way"
                continue
            found.append(proposal)
        if not found:
            return None
        return max(found, key=lambda p: (p.confirmed, p.strength, -p.first, -p.second))

    def _proposed(self, a: int, b: int, crossing: Sequence[int]) -> _Proposal | None:
        """What most links from group ``b`` to group ``a`` agree on."""
        motions = {k: self._a_from_b(self._links[k], a) for k in crossing}
        marks = np.concatenate([apply(self._pose[m], self._marks[m]) for m in self._members(b)])
        gap = {
            (k, m): self._apart(motions[k], motions[m], marks) for k, m in combinations(crossing, 2)
        }

        def agree(k: int, m: int) -> bool:
            return k == m or gap[min(k, m), max(k, m)] <= self._tolerance_m

        bundles = []
        for k in crossing:
            bundle = tuple(m for m in crossing if agree(k, m))
            if bundle not in self._refused:
                bundles.append((sum(self._strength[m] for m in bundle), k, bundle))
        if not bundles:
            return None
        strength, centre, bundle = max(bundles, key=lambda item: (item[0], -item[1]))
        confirmed = self._confirmed(bundle)
        # Against a motion that loops confirm, one they do not confirm is no rival.
        rivals = [
            other_strength
            for other_strength, _, other in bundles
            if not set(other) & set(bundle) and self._confirmed(other) >= confirmed
        ]
        rivalled = max(rivals, default=0.0) > _RIVAL * strength
        return _Proposal(a, b, motions[centre], bundle, strength, confirmed, rivalled)

    def _confirmed(self, bundle: Sequence[int]) -> bool:
        """Whether links agree on a loop: two between the groups, or one with a triangle."""
        pairs = {(self._links[m].source, self._links[m].target) for m in bundle}
        return len(pairs) > 1 or any(self._support[m] > 0 for m in bundle)

    def _a_from_b(self, link: Link, a: int) -> Matrix4:
        """Where a link puts the group at its other end, in the frame of group ``a``."""
        if self._group[link.source] == a:
            motion = self._pose[link.source] @ inverse(link.target_from_source)
            return motion @ inverse(self._pose[link.target])
        motion = self._pose[link.target] @ link.target_from_source
        return motion @ inverse(self._pose[link.source])

    def _merge(self, proposal: _Proposal) -> None:
        for k, pose in self._placed(proposal.second, proposal.first_from_second).items():
            self._pose[k], self._group[k] = pose, proposal.first
        if not proposal.confirmed:
            self._unconfirmed.append(proposal.links[0])

    def _agrees(self, link: Link) -> bool:
        if self._group[link.source] != self._group[link.target]:
            return False
        found = inverse(self._pose[link.target]) @ self._pose[link.source]
        apart = self._apart(found, link.target_from_source, self._marks[link.source])
        return apart <= 2.0 * self._tolerance_m
