"""Registration where shape says little, samples lie, or numbers are far from one."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from workbench.geometry.orientedscan import OrientationSettings, OrientedScan, orient
from workbench.geometry.rangemap import RangeMap
from workbench.geometry.transforms import apply, from_twist, inverse
from workbench.registration.adjustment import Adjustment, AdjustmentSettings, adjust
from workbench.registration.placement import PlacementSettings, place
from workbench.stability.case import Bound, Case, Measured, Refused
from workbench.stability.scanned_bodies import (
    Scanned,
    ball,
    body_scans,
    cylinder_scans,
    sheet_scans,
    wavy,
)

_METHOD = "joint adjustment of scans"
# 1600 samples of 0.5 mm noise hold a scan to a few hundredths of a millimetre; a tenth of the
# sample spacing, some 2 mm, is what the matching of discrete samples leaves at most.
_TENTH = "a tenth of the sample spacing: what matching discrete samples leaves"
_UTM = np.array([512_345.0, 5_412_345.0, 312.0])


def _adjusted(scene: Scanned) -> Adjustment:
    return adjust(scene.scans, scene.coarse, scene.names, AdjustmentSettings())


def _told(found: Adjustment) -> str:
    free = f", {len(found.freedoms)} free motions" if found.freedoms else ""
    return f"condition {found.condition:.3g}, residual {1e3 * found.sigma_m:.3g} mm{free}"


def _held(
    scene: Scanned, freedoms: int, error: Callable[[Adjustment], float]
) -> Measured | Refused:
    """An error in spacings that counts only if all free motions are named, and no more."""
    found = _adjusted(scene)
    if not found:
        return Refused(found.reason)
    if len(found.freedoms) != freedoms:
        return Measured.nothing(f"{len(found.freedoms)} free motions named, there are {freedoms}")
    return Measured(error(found) / scene.spacing_m, _told(found))


def _sphere() -> Measured | Refused:
    scene = body_scans(ball)

    def apart(found: Adjustment) -> float:
        middles = np.array(
            [(p @ inverse(t))[:3, 3] for p, t in zip(found.poses, scene.true, strict=True)]
        )
        return float(np.linalg.norm(middles - middles[found.anchor], axis=1).max())

    return _held(scene, 3 * 4, apart)


def _cylinder() -> Measured | Refused:
    scene = cylinder_scans()

    def off_axis(found: Adjustment) -> float:
        """How far axes lie apart at the ends of the cylinder."""
        ends = np.array([[0.0, 0.0, -0.5], [0.0, 0.0, 0.5]])
        true_from_found = scene.true[found.anchor] @ inverse(found.poses[found.anchor])
        moved = [
            apply(true_from_found @ pose @ inverse(true), ends)
            for pose, true in zip(found.poses, scene.true, strict=True)
        ]
        return float(np.linalg.norm(np.array(moved)[..., :2], axis=-1).max())

    return _held(scene, 2 * 4, off_axis)


def _height_error(scene: Scanned, found: Adjustment) -> float:
    return float(np.abs(scene.center_errors_m(found.poses, found.anchor)[:, 2]).max())


def _plane() -> Measured | Refused:
    scene = sheet_scans(lambda x, y: np.zeros_like(x))
    return _held(scene, 3 * 2, partial(_height_error, scene))


def _nearly_plane() -> Measured | Refused:
    # Normals spread by a tenth of what the noise turns them: slides are not to be believed.
    scene = sheet_scans(lambda x, y: 2e-5 * np.sin(20 * x) * np.cos(20 * y))
    return _held(scene, 3 * 2, partial(_height_error, scene))


def _groove() -> Measured | Refused:
    """One shallow groove across a plane: it holds one slide and the turn, and only those."""
    scene = sheet_scans(lambda x, y: -0.02 * np.exp(-((x / 0.05) ** 2)))

    def across(found: Adjustment) -> float:
        return float(np.abs(scene.center_errors_m(found.poses, found.anchor)[:, [0, 2]]).max())

    return _held(scene, 2, across)


def _thin_sheet() -> Measured | Refused:
    # Both sides of a sheet thinner than half a sample spacing.
    scene = sheet_scans(wavy, (0.0, 0.0), from_below=(False, True))
    return _largest_shift(scene)


def _largest_shift(scene: Scanned) -> Measured | Refused:
    found = _adjusted(scene)
    if not found:
        return Refused(found.reason)
    if found.freedoms:
        return Refused("; ".join(freedom.sentence for freedom in found.freedoms))
    errors = np.linalg.norm(scene.center_errors_m(found.poses, found.anchor), axis=1)
    return Measured(float(errors.max()) / scene.spacing_m, _told(found))


def _little_overlap() -> Measured | Refused:
    # One pair more than 5 % of whose area is shared, less than 6 %.
    return _largest_shift(sheet_scans(wavy, (0.0, 0.945), side=60, coarse_m=0.002))


def _outliers() -> Measured | Refused:
    """Clutter of every scan's own, 60 % of its samples, in the box of the body."""
    scene = body_scans()
    rng = np.random.default_rng(5)
    return _largest_shift(
        replace(scene, scans=tuple(_cluttered(scan, 0.6, rng) for scan in scene.scans))
    )


def _cluttered(scan: OrientedScan, share: float, rng: np.random.Generator) -> OrientedScan:
    wrong = rng.random(len(scan)) < share
    low, high = scan.points.min(axis=0), scan.points.max(axis=0)
    normals = rng.standard_normal(scan.points.shape)
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    return replace(
        scan,
        points=np.where(wrong[:, None], rng.uniform(low, high, scan.points.shape), scan.points),
        normals=np.where(wrong[:, None], normals, scan.normals),
    )


def _other_unit(factor: float) -> Measured | Refused:
    scene = body_scans()
    here, there = _adjusted(scene), _adjusted(scene.scaled(factor))
    if not (here and there):
        return Refused(there.reason or here.reason)
    return Measured(_pose_gap(here.poses, there.poses, factor), _told(there))


def _pose_gap(
    one: tuple[NDArray[np.float64], ...], other: tuple[NDArray[np.float64], ...], factor: float
) -> float:
    gaps = [
        max(
            np.abs(a[:3, :3] - b[:3, :3]).max(),
            np.abs(a[:3, 3] - b[:3, 3] / factor).max(),
        )
        for a, b in zip(one, other, strict=True)
    ]
    return float(max(gaps))


def _far_world() -> Measured | Refused:
    scene = body_scans()
    here, there = _adjusted(scene), _adjusted(scene.moved(_UTM))
    if not (here and there):
        return Refused(there.reason or here.reason)
    back = from_twist([0.0, 0.0, 0.0, *-_UTM])
    return Measured(
        _pose_gap(here.poses, tuple(back @ pose for pose in there.poses), 1.0), _told(there)
    )


def _single_precision() -> Measured | Refused:
    scene = body_scans()
    scans = tuple(
        replace(scan, points=scan.points.astype(np.float32).astype(np.float64))
        for scan in scene.scans
    )
    return _largest_shift(replace(scene, scans=scans))


def _single_precision_far() -> Measured | Refused:
    """Samples stored in single precision at UTM coordinates: half a metre apart at best."""
    scene = body_scans()
    scans = []
    for k, (scan, pose) in enumerate(zip(scene.scans, scene.true, strict=True)):
        far = (apply(pose, scan.points) + _UTM).astype(np.float32).astype(np.float64)
        scans.append(orient(RangeMap(f"scan_{k}", far), OrientationSettings()))
    there = tuple(from_twist([0.0, 0.0, 0.0, *(0.01 * k, 0.0, 0.0)]) for k in range(len(scans)))
    found = adjust(scans, there, scene.names, AdjustmentSettings())
    return Measured.nothing(_told(found)) if found else Refused(found.reason)


def _empty_scan() -> Measured | Refused:
    scene = body_scans(views=3)
    scans = (*scene.scans[:2], scene.scans[2].take(np.zeros(0, np.int64)))
    return _largest_shift(replace(scene, scans=scans))


def _placed_ball() -> Measured | Refused:
    return _placed(body_scans(ball, views=4))


def _placed_plane() -> Measured | Refused:
    return _placed(sheet_scans(lambda x, y: np.zeros_like(x)))


def _placed(scene: Scanned) -> Measured | Refused:
    found = place(scene.scans, scene.viewpoints, scene.names, PlacementSettings(threads=1))
    if not found:
        return Refused(found.reason)
    return Measured.nothing(f"placed with a loop error of {found.loop_error_m:.3g} m")


def _case(
    name: str,
    stiff: str,
    run: Callable[[], Measured | Refused],
    bound: Bound | None = None,
    refusal: str | None = None,
    method: str = _METHOD,
    quick: bool = True,
) -> Case:
    return Case(f"registration/{name}", method, stiff, run, bound, refusal, quick)


_SPACINGS = Bound(0.1, "spacings", _TENTH)
_ROUNDING = Bound(1e-6, "", "rounding alone may differ: the steps are the same to the bit or two")

REGISTRATION_CASES = (
    _case("plane", "Two slides and a turn leave a plane as it is.", _plane, _SPACINGS),
    _case("sphere", "Every turn leaves a sphere as it is.", _sphere, _SPACINGS),
    _case("cylinder", "A slide and a turn leave a cylinder as it is.", _cylinder, _SPACINGS),
    _case("near-identical normals", "Relief whose normals turn less than noise turns them.",
          _nearly_plane, _SPACINGS),
    _case("groove", "One groove in a plane: one of the slides is seen, the other is not.",
          _groove, _SPACINGS),
    _case("thin sheet", "Two sides of a sheet without thickness, which must not be matched.",
          _thin_sheet, refusal="overlap no other"),
    _case("overlap of 5 %", "Two scans share a strip of 5 % of their area.",
          _little_overlap,
          Bound(0.5, "spacings", "a strip of 5 % holds the far middle 10 times less firmly"),
          "overlap no other"),
    _case("outliers 60 %", "Three samples in five are clutter.", _outliers,
          Bound(0.3, "spacings", "noise over the 40 % that are left, and clutter that is matched"),
          "can turn about"),
    _case("scale 1e-6", "A body of a third of a micrometre.", partial(_other_unit, 1e-6),
          _ROUNDING),
    _case("scale 1e5", "A body of thirty kilometres.", partial(_other_unit, 1e5), _ROUNDING),
    _case("UTM offset", "The world's origin is 5400 km away.", _far_world,
          Bound(1e-6, "m", "a thousand times the spacing of float64 there")),
    _case("float32 samples", "Samples in single precision about their own origin.",
          _single_precision, _SPACINGS),
    _case("float32 at UTM", "Single precision at UTM coordinates: half a metre is one step.",
          _single_precision_far, refusal="overlap no other"),
    _case("empty scan", "One of the scans has no samples left.", _empty_scan,
          refusal="overlap no other"),
    _case("lost ball", "A ball without poses: nothing tells its sides apart.", _placed_ball,
        refusal="can slide or turn", method="placement by shape"),
    _case("lost plane", "A plane without poses.", _placed_plane,
        refusal="no shape in common",
          method="placement by shape"),
)  # fmt: skip
