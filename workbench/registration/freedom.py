"""Directions in which the scans do not hold each other, found and put into words.

The normal matrix of the joint adjustment hardly changes along a motion that changes no
residual: a plane slides along itself, a sphere turns about its centre. How much a motion
is felt is measured against what it would be if every match held its points in all three
directions: the share of the squared motion that the normals see, in [0, 1]. Noise in the
normals lifts that share off zero, so a fixed threshold would take noise for constraint;
the floor used here is what the observed disagreement of matched normals alone would give.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

# A share this many times the noise floor is taken for a real constraint.
_FLOOR_FACTOR = 4.0
# A smaller share is not told from zero in float64.
_LEAST_SHARE = 1e-9
# The mean squared angle between two equally wrong normals times this is the mean squared
# error of their bisector along one direction.
_BISECTOR_ERROR = 1 / 8
# A motion is one scan's own where others take part less than this (sine of the angle), and a
# slide where it turns less.
_OWN, _SLIDE = 0.1, 0.2


@dataclass(frozen=True)
class Freedom:
    """One unconstrained motion.

    Attributes
    ----------
    motion : (6 · scans,) float64 unit vector; per scan rotation (times radius) then
        translation, world axes.
    scans : names of those it moves, strongest first.
    sentence : for people: "scan_02 can slide along x".
    """

    motion: NDArray[np.float64]
    scans: tuple[str, ...]
    sentence: str


def unconstrained(shares: NDArray[np.float64], squared_angle: float) -> NDArray[np.bool_]:
    """Which motions are felt no more than noise in the normals would make them.

    Parameters
    ----------
    shares : (k,) seen share of each motion, in [0, 1].
    squared_angle : weighted mean of the squared angle between matched normals, rad². Not
        its median: the few bad normals at grazing rims are what a free motion feels.
    """
    floor = _FLOOR_FACTOR * _BISECTOR_ERROR * squared_angle
    return shares <= max(floor, _LEAST_SHARE)


def told_apart(motions: NDArray[np.float64]) -> list[NDArray[np.float64]]:
    """Unconstrained motions, one scan at a time and slides before turns where they can be.

    Parameters
    ----------
    motions : (6 · scans, k), columns that span the unconstrained motions: any mixture.

    Returns
    -------
    k unit vectors that span the same; first what a scan can do alone, then what several do
    together.
    """
    rest, _ = np.linalg.qr(motions)
    found: list[NDArray[np.float64]] = []
    for start in range(0, len(rest), 6):
        if not rest.shape[1]:
            break
        _, share, mixture = np.linalg.svd(rest[start : start + 6])
        alone = np.zeros(rest.shape[1], bool)
        alone[: len(share)] = share > np.sqrt(1.0 - _OWN**2)
        own, rest = rest @ mixture[alone].T, rest @ mixture[~alone].T
        _, turning, order = np.linalg.svd(own[start : start + 3], full_matrices=True)
        slide = np.ones(own.shape[1], bool)
        slide[: len(turning)] = turning <= _SLIDE
        found += _along_axes(own @ order[slide].T, start + 3)
        found += _along_axes(own @ order[~slide].T, start)
    return [*found, *rest.T]


def _along_axes(motions: NDArray[np.float64], start: int) -> list[NDArray[np.float64]]:
    """The span of ``motions`` by vectors as parallel as can be to the axes at ``start``."""
    found = []
    while motions.shape[1]:
        axis = motions[start : start + 3]
        strongest = int(np.argmax((axis**2).sum(axis=1)))
        _, _, mixture = np.linalg.svd(axis[strongest : strongest + 1])
        turned = motions @ mixture.T
        found.append(turned[:, 0] * np.sign(turned[start + strongest, 0] or 1.0))
        motions = turned[:, 1:]
    return found


def freedom_in_words(motion: NDArray[np.float64], names: Sequence[str]) -> Freedom:
    """Name the scans a motion moves and how."""
    parts = motion.reshape(-1, 6)
    strength = np.linalg.norm(parts, axis=1)
    order = np.argsort(-strength, kind="stable")
    moved = [int(k) for k in order if strength[k] > 0.3 * strength.max()]
    leading = parts[moved[0]]
    turn, slide = leading[:3], leading[3:]
    if np.linalg.norm(slide) >= np.linalg.norm(turn):
        how = f"slide along {_axis(slide)}"
    else:
        how = f"turn about {_axis(turn)}"
    who = names[moved[0]]
    if len(moved) > 1:
        who += " (with " + ", ".join(names[k] for k in moved[1:]) + ")"
    return Freedom(motion, tuple(names[k] for k in moved), f"{who} can {how}")


def _axis(vector: NDArray[np.float64]) -> str:
    unit = vector / np.linalg.norm(vector)
    strongest = int(np.argmax(np.abs(unit)))
    if abs(unit[strongest]) > 0.95:
        return "xyz"[strongest]
    # One sign for a line: its first clear component is positive.
    unit = unit * np.sign(unit[strongest])
    return "({:.2f}, {:.2f}, {:.2f})".format(*unit)
