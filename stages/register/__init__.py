"""Bring all scans into one frame: place those without a pose, refine all together."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from time import perf_counter
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from pydantic import Field

from stages.register.held_scans import HeldScans, held_scans, own_poses
from workbench.errors import InputError
from workbench.geometry.transforms import Matrix4, inverse, rigid, rotation_angle_deg
from workbench.metrics import Metric
from workbench.pipeline.knobs import Knob
from workbench.pipeline.stage import Estimate, Job, Need, Stage, StageResult
from workbench.project.project import Scene
from workbench.project.settings import StageOptions

if TYPE_CHECKING:
    from workbench.registration.adjustment import Adjustment, AdjustmentSettings
    from workbench.registration.placement import Placement

# Scans placed by their shape lie within a keypoint or so of where they belong.
_SEARCH_KEYPOINTS = 1.5


class RegisterOptions(StageOptions):
    """Options of ``register``."""

    placement: Literal["auto", "given", "features"] = Field(
        "auto",
        description="Coarse poses: auto takes those given and places scans without one by their "
        "shape, given refuses scans without one, features places all by their shape.",
    )
    keypoints: int = Field(
        700,
        ge=100,
        le=5000,
        description="Places compared on a scan of median size where scans are placed by their "
        "shape; more find smaller overlaps and take the square of the time.",
    )
    samples_per_scan: int = Field(
        6000, ge=200, le=1_000_000, description="Samples of a scan that look for a partner."
    )
    memory_samples: int = Field(
        20_000_000,
        ge=10_000,
        description="Samples of all scans held at once, some 150 bytes each; scans with more are "
        "thinned alike.",
    )
    search_m: float | None = Field(
        None,
        gt=0.0,
        description="How far partners may lie apart at first; 3 % of the scene, or the distance "
        "of keypoints after placement by shape.",
    )
    min_overlap: float = Field(
        0.05, gt=0.0, le=1.0, description="Pairs of scans that share less are left apart."
    )
    max_rounds: int = Field(60, ge=1, le=1000, description="Rounds of matching at most.")
    min_gain: float = Field(
        0.1,
        ge=0.0,
        lt=1.0,
        description="Given poses that already fit keep their values: refinement must lower the "
        "residual by this share, else what it changes is no better than noise.",
    )
    partial: bool = Field(
        False, description="Go on, with a warning, where some scans overlap no other."
    )


def needed(scene: Scene, options: RegisterOptions) -> Need:
    if not scene.scans:
        return Need(False, "no range scans")
    if options.placement == "features":
        return Need(True, "given poses are not used: scans are placed by their shape")
    if scene.poses or scene.scans == 1:
        return Need(True, "coarse poses to refine" if scene.poses else "a scan to put in place")
    return Need(True, "no pose files: scans without a pose are placed by their shape")


def estimate(scene: Scene, options: RegisterOptions) -> Estimate:
    # Points, normals and trees of the samples held; about 250 bytes for some 20 in the file.
    # Two pairs at a time hold tables of a few thousand correspondences against each other.
    held = min(12 * scene.scan_bytes, 250 * options.memory_samples)
    largest = 12 * scene.scan_bytes // max(scene.scans, 1)
    return Estimate(held + largest + 2**29, 2**24)


def run(job: Job[RegisterOptions]) -> StageResult:
    from workbench.registration.adjustment import adjust

    products, options = job.products, job.options
    inventory = products.load("scan_inventory")
    if len(inventory["scans"]) == 1:
        products.save("scan_poses", _poses(inventory, {0: own_poses(inventory)[0]}))
        none = np.zeros(0)
        products.save("registration", {"overlap": np.eye(1), "before_m": none, "after_m": none})
        return StageResult((Metric("scans_placed", 1, "", "Range maps in the common frame."),))
    scans = held_scans(job, inventory)
    settings = _settings(options)
    start = perf_counter()
    coarse, placement, warnings = _coarse(job, scans, settings)
    seconds = perf_counter() - start
    members = sorted(coarse.keys() & set(scans.sound()))
    if placement is not None and settings.search_m is None:
        settings = replace(settings, search_m=_SEARCH_KEYPOINTS * placement.keypoint_m)
    with job.progress.step("joint adjustment") as step:
        found = adjust(
            _of(scans.oriented, members),
            _of(coarse, members),
            _of(scans.names, members),
            settings,
            on_round=lambda _: step.advance(),
        )
    warnings += _findings(found, _of(scans.names, members), options)
    gain = 1.0 - found.sigma_m / found.sigma_given_m if found.sigma_given_m else 0.0
    # Poses that nobody gave are not worth keeping.
    kept = placement is None and gain < options.min_gain
    refined = dict(zip(members, found.poses, strict=True))
    if placement is not None:
        refined = _standing(refined, scans.first(members), coarse)
    poses = coarse if kept else coarse | refined
    products.save("scan_poses", _poses(inventory, poses))
    products.save("registration", _arrays(found, members, len(scans.names), kept))
    moved = [inverse(coarse[k]) @ poses[k] for k in members]
    metrics = _metrics(found, moved, len(poses), gain, kept)
    if placement is not None:
        metrics += placement.metrics()
        metrics += (Metric("placement_seconds", seconds, "s", "Time the placement by shape took."),)
    return StageResult(metrics, tuple(warnings))


def _coarse(
    job: Job[RegisterOptions], scans: HeldScans, settings: AdjustmentSettings
) -> tuple[dict[int, Matrix4], Placement | None, list[str]]:
    """Coarse project_from_scan: as given, and by shape of sound scans without a given pose."""
    from workbench.registration.adjustment import adjust
    from workbench.registration.placement import PlacementSettings, place

    sound, poses = scans.sound(), dict(scans.given)
    warnings = [
        f"{name} has no surface that can be trusted: "
        + ("kept where it was" if k in poses else "left out")
        for k, name in enumerate(scans.names)
        if k not in sound
    ]
    if all(k in poses for k in sound):
        return poses, None, warnings
    given = [k for k in sound if k in poses]
    if len(given) > 1:
        # What is placed to them had better find them at rest.
        rest = adjust(
            _of(scans.oriented, given), _of(poses, given), _of(scans.names, given), settings
        )
        refined = dict(zip(given, rest.poses, strict=True))
        poses |= _standing(refined, scans.first(given), poses)
    with job.progress.step("pairs of scans compared") as step:
        placement = place(
            _of(scans.oriented, sound),
            _of(scans.viewpoints, sound),
            _of(scans.names, sound),
            PlacementSettings(keypoints=job.options.keypoints),
            [poses.get(k) for k in sound],
            on_pair=lambda _: step.advance(),
        )
    # Where poses are given, the world is theirs, however few they are.
    main = placement.group_of(sound.index(given[0])) if given else placement.largest_group()
    together = [sound[k] for k in main]
    found = {k: placement.poses[sound.index(k)] for k in together}
    if not given:
        found = _standing(found, scans.first(together), scans.own)
    if not placement:
        groups = _groups(_of(scans.names, sound), placement.component)
        if not job.options.partial:
            raise InputError(
                "Some scans could not be placed by their shape",
                found=f"{groups}; {placement.reason}",
                fix="scan what lies between, give these scans poses, raise register.keypoints, "
                "or --set register.partial=true",
            )
        left = ", ".join(scans.names[k] for k in sound if k not in poses | found)
        warnings.append(f"not placed and left out: {left}; {placement.reason}")
    if placement.unconfirmed:
        pairs = (f"{scans.names[sound[a.source]]} and {scans.names[sound[a.target]]}"
                 for a in placement.unconfirmed)  # fmt: skip
        warnings.append(f"placed by one link each that no loop confirms: {'; '.join(pairs)}")
    return poses | found, placement, warnings


def _settings(options: RegisterOptions) -> AdjustmentSettings:
    from workbench.registration.adjustment import AdjustmentSettings

    return AdjustmentSettings(
        samples_per_scan=options.samples_per_scan,
        search_m=options.search_m,
        min_overlap=options.min_overlap,
        max_rounds=options.max_rounds,
    )


def _of(values: Any, members: Iterable[int]) -> list[Any]:
    return [values[k] for k in members]


def _standing(
    poses: dict[int, Matrix4], first: int, at: dict[int, Matrix4] | list[Matrix4]
) -> dict[int, Matrix4]:
    """The poses moved together so that scan ``first`` stands where it does in ``at``."""
    move = at[first] @ inverse(poses[first])
    return {k: move @ pose for k, pose in poses.items()} | {first: at[first]}


def _findings(found: Adjustment, names: list[str], options: RegisterOptions) -> list[str]:
    """Warnings of the adjustment; raises where scans fall apart and may not."""
    warnings = [f"{freedom.sentence}: kept where it was" for freedom in found.freedoms]
    if not found.graph.connected:
        groups = _groups(names, found.graph.component)
        if not options.partial:
            raise InputError(
                "Some scans overlap no other",
                found=groups,
                fix="check their coarse poses, scan what lies between, "
                "or --set register.partial=true",
            )
        warnings.append(f"scans that do not hang together: {groups}")
    elif not found:
        warnings.append(found.reason)
    return warnings


def _poses(inventory: dict[str, Any], project_from_scan: dict[int, Matrix4]) -> dict[str, Any]:
    """``scan_poses.json``: into the user's world, from the coordinates of the user's files."""
    to_world = rigid(np.eye(3), inventory["origin_m"])
    scans = {}
    for k in sorted(project_from_scan):
        entry = inventory["scans"][k]
        unshifted = rigid(np.eye(3), -np.array(entry["scan_shift_m"]))
        pose = to_world @ project_from_scan[k] @ unshifted
        scans[entry["name"]] = {"world_from_scan": pose.tolist()}
    return {"origin": inventory["origin_m"], "scans": scans}


def _arrays(found: Adjustment, members: list[int], n: int, kept: bool) -> dict[str, Any]:
    """``registration.npz``; scans left out share nothing and have no covariance."""
    overlap, covariance = np.zeros((n, n)), np.full((n, 6, 6), np.nan)
    overlap[np.ix_(members, members)] = found.graph.fraction
    covariance[members] = found.covariance
    return {
        "overlap": overlap,
        "before_m": found.residuals_before,
        "after_m": found.residuals_given if kept else found.residuals_after,
        "covariance": covariance,
    }


def _groups(names: list[str], component: Any) -> str:
    found = [
        "{" + ", ".join(n for n, c in zip(names, component, strict=True) if c == k) + "}"
        for k in range(int(component.max()) + 1)
    ]
    return " and ".join(found)


def _metrics(
    found: Adjustment, moved: list[Matrix4], placed: int, gain: float, kept: bool
) -> tuple[Metric, ...]:
    deviation = np.sqrt(np.diagonal(found.covariance, axis1=1, axis2=2))
    return (
        Metric("scans_placed", placed, "", "Range maps in the common frame."),
        Metric("overlapping_pairs", len(found.graph.pairs), "", "Pairs adjusted to each other."),
        Metric("rounds", found.rounds, "", "Rounds of matching until nothing moved."),
        Metric("converged", found.converged, "", "Whether the poses came to rest."),
        Metric(
            "residual_given",
            found.sigma_given_m,
            "m",
            "Robust standard deviation between overlapping scans at the coarse poses.",
        ),
        Metric("residual_refined", found.sigma_m, "m", "The same at the refined poses."),
        Metric("gain", gain, "", "Share by which refinement lowers the residual."),
        Metric(
            "given_poses_kept",
            kept,
            "",
            "True where the given poses already fit as well as the scans can tell.",
        ),
        Metric(
            "largest_rotation",
            max(rotation_angle_deg(m) for m in moved),
            "deg",
            "Largest change of a scan's orientation by refinement.",
        ),
        Metric(
            "pose_sigma_translation",
            float(deviation[:, 3:].max()),
            "m",
            "Largest standard deviation of a scan's place, from the normal matrix.",
        ),
        Metric(
            "pose_sigma_rotation",
            float(np.degrees(deviation[:, :3].max())),
            "deg",
            "Largest standard deviation of a scan's orientation.",
        ),
        Metric(
            "condition",
            found.condition,
            "",
            "Best over least seen motion; large where some motion is hardly held.",
        ),
        Metric(
            "unconstrained_motions",
            len(found.freedoms),
            "",
            "Motions the scans cannot fix, kept as they were.",
        ),
    )


REGISTER = Stage(
    name="register",
    version=2,
    summary="Places scans without poses by shape, refines all together, says how sure they are.",
    options=RegisterOptions,
    reads=("scan_inventory", "range_maps", "scan_masks"),
    writes=("scan_poses", "registration"),
    needed=needed,
    run=run,
    libraries=("numpy", "scipy", "open3d", "numba"),
    estimate=estimate,
    knobs=(Knob("samples_per_scan", (500, 1500, 3000, 6000, 12_000), quick=(1500,)),),
)
