"""Refine the coarse poses of all scans together."""

from __future__ import annotations

from typing import Any

import numpy as np
from pydantic import Field

from workbench.errors import InputError
from workbench.geometry.transforms import Matrix4, inverse, rigid, rotation_angle_deg
from workbench.metrics import Metric
from workbench.pipeline.stage import Estimate, Job, Need, Stage, StageResult
from workbench.project.project import Scene
from workbench.project.settings import StageOptions


class RegisterOptions(StageOptions):
    """Options of ``register``."""

    samples_per_scan: int = Field(
        6000, ge=200, le=1_000_000, description="Samples of a scan that look for a partner."
    )
    search_m: float | None = Field(
        None, gt=0.0, description="How far partners may lie apart at first; 3 % of the scene."
    )
    min_overlap: float = Field(
        0.05, gt=0.0, le=1.0, description="Pairs of scans that share less are left apart."
    )
    max_rounds: int = Field(60, ge=1, le=1000, description="Rounds of matching at most.")
    min_gain: float = Field(
        0.1,
        ge=0.0,
        lt=1.0,
        description="Poses that already fit keep their values: refinement must lower the "
        "residual by this share, else what it changes is no better than noise.",
    )
    partial: bool = Field(
        False, description="Go on, with a warning, where some scans overlap no other."
    )


def needed(scene: Scene, options: RegisterOptions) -> Need:
    if not scene.scans:
        return Need(False, "no range scans")
    return Need(True, "coarse poses to refine" if scene.poses else "scans to bring together")


def estimate(scene: Scene, options: RegisterOptions) -> Estimate:
    # Points, normals and trees of every trusted sample; about 250 bytes for some 20 in the file.
    return Estimate(12 * scene.scan_bytes + 2**28, 2**24)


def run(job: Job[RegisterOptions]) -> StageResult:
    from workbench.geometry.orientedscan import OrientationSettings, orient
    from workbench.registration.adjustment import AdjustmentSettings, adjust

    products, options = job.products, job.options
    inventory = products.load("scan_inventory")
    origin, entries = np.array(inventory["origin_m"]), inventory["scans"]
    names = [entry["name"] for entry in entries]
    to_project = rigid(np.eye(3), -origin)
    coarse = [to_project @ np.array(entry["world_from_scan"]) for entry in entries]
    if len(names) == 1:
        products.save("scan_poses", _poses(inventory, coarse))
        none = np.zeros(0)
        products.save("registration", {"overlap": np.eye(1), "before_m": none, "after_m": none})
        return StageResult((Metric("scans_placed", 1, "", "Range maps in the common frame."),))
    scans = []
    with job.progress.step("normals", len(names)) as step:
        for name in names:
            scans.append(orient(products.load("range_maps", name), OrientationSettings()))
            step.advance()
    empty = [name for name, scan in zip(names, scans, strict=True) if len(scan) < 6]
    if empty:
        raise InputError(
            "Some scans have no surface that can be trusted",
            found=", ".join(empty),
            fix="leave them out, or check ingest.scan_unit",
        )
    settings = AdjustmentSettings(
        samples_per_scan=options.samples_per_scan,
        search_m=options.search_m,
        min_overlap=options.min_overlap,
        max_rounds=options.max_rounds,
    )
    with job.progress.step("joint adjustment") as step:
        found = adjust(scans, coarse, names, settings, on_round=lambda _: step.advance())
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
    gain = 1.0 - found.sigma_m / found.sigma_given_m if found.sigma_given_m else 0.0
    kept = gain < options.min_gain
    poses = coarse if kept else list(found.poses)
    products.save("scan_poses", _poses(inventory, poses))
    products.save(
        "registration",
        {
            "overlap": found.graph.fraction,
            "before_m": found.residuals_before,
            "after_m": found.residuals_given if kept else found.residuals_after,
            "covariance": found.covariance,
        },
    )
    return StageResult(_metrics(found, coarse, poses, gain, kept), tuple(warnings))


def _poses(inventory: dict[str, Any], project_from_scan: list[Matrix4]) -> dict[str, Any]:
    """``scan_poses.json``: into the user's world, from the coordinates of the user's files."""
    to_world = rigid(np.eye(3), inventory["origin_m"])
    scans = {}
    for entry, pose in zip(inventory["scans"], project_from_scan, strict=True):
        unshifted = rigid(np.eye(3), -np.array(entry["scan_shift_m"]))
        scans[entry["name"]] = {"world_from_scan": (to_world @ pose @ unshifted).tolist()}
    return {"origin": inventory["origin_m"], "scans": scans}


def _groups(names: list[str], component: Any) -> str:
    found = [
        "{" + ", ".join(n for n, c in zip(names, component, strict=True) if c == k) + "}"
        for k in range(int(component.max()) + 1)
    ]
    return " and ".join(found)


def _metrics(
    found: Any, coarse: list[Matrix4], poses: list[Matrix4], gain: float, kept: bool
) -> tuple[Metric, ...]:
    moved = [inverse(a) @ b for a, b in zip(coarse, poses, strict=True)]
    deviation = np.sqrt(np.diagonal(found.covariance, axis1=1, axis2=2))
    return (
        Metric("scans_placed", len(poses), "", "Range maps in the common frame."),
        Metric("overlapping_pairs", len(found.graph.pairs), "", "Pairs adjusted to each other."),
        Metric("rounds", found.rounds, "", "Rounds of matching until nothing moved."),
        Metric("converged", found.converged, "", "Whether the poses came to rest."),
        Metric(
            "residual_given",
            found.sigma_given_m,
            "m",
            "Robust standard deviation between overlapping scans at the given poses.",
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
            "Largest change of a scan's orientation.",
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
            "Motions the scans cannot fix, kept as given.",
        ),
    )


REGISTER = Stage(
    name="register",
    version=1,
    summary="Refines the coarse poses of all scans together and says how sure they are.",
    options=RegisterOptions,
    reads=("scan_inventory", "range_maps"),
    writes=("scan_poses", "registration"),
    needed=needed,
    run=run,
    libraries=("numpy", "scipy"),
    estimate=estimate,
)
