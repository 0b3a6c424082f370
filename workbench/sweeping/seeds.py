"""The same sweep on simulations of other seeds: how sure errors are, and whether advice holds."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from shutil import copyfile
from typing import Any

import numpy as np

from workbench.errors import InputError
from workbench.pipeline.planner import Pipeline
from workbench.pipeline.progress import Progress
from workbench.pipeline.runner import RunRequest, run_pipeline
from workbench.project.project import Project
from workbench.project.simulated import simulate_project
from workbench.project.user_masks import mask_folder
from workbench.sweeping.recommendation import Budget
from workbench.sweeping.scratch import SWEEP_FOLDER
from workbench.sweeping.sweep import SweepRequest, cost_of, sweep

# A knee is as good elsewhere when error × time is at most so much above the least there.
_KNEE_SLACK = 1.25
# Seconds of other runs on a shared machine.
_TIME_SLACK = 1.25
_NAMED = ("scene", "size", "scans")
_PHOTOS = "photos"


def sweep_of_seeds(
    pipeline: Pipeline,
    project: Project,
    request: SweepRequest,
    seeds: int,
    progress: Progress,
) -> dict[str, Any]:
    """`sweep` on a simulated project and on others like it, of the seeds that follow its own.

    Returns
    -------
    What `sweep` returns of the project, where points have ``seeds`` too: ``count``,
    ``error_mean``, ``error_std``, ``wall_mean``, ``wall_std``; and recommendations ``checked``: a
    list of ``seed``, ``holds`` and ``told`` for every other seed.

    Raises
    ------
    InputError
        The project is not simulated.
    """
    told = sweep(pipeline, project, request, progress)
    others: dict[int, dict[str, Any]] = {}
    for other, seed in _others(pipeline, project, request, seeds - 1, progress):
        others[seed] = sweep(pipeline, other, request, progress)
    for point in told["points"]:
        twins = [point, *(_twin(point, one["points"]) for one in others.values())]
        point["seeds"] = _statistics([one for one in twins if one is not None])
    for choice in told["recommended"]:
        choice["checked"] = [
            {"seed": seed, **_checked(choice, one["points"], request.budget)}
            for seed, one in others.items()
        ]
    return told


def _others(
    pipeline: Pipeline, project: Project, request: SweepRequest, count: int, progress: Progress
) -> Iterator[tuple[Project, int]]:
    """Projects of further seeds, simulated and brought as far as the sweep asks."""
    if not project.store.exists("simulation"):
        raise InputError(
            "Other seeds are those of a simulation",
            file=project.root,
            found="a project without a truth",
            fix="leave out --seeds",
        )
    options = project.store.load("simulation")["options"]
    names = [stage.name for stage in pipeline]
    wanted = request.stages or tuple(request.knobs) or tuple(s.name for s in pipeline if s.knobs)
    last = max(wanted, key=names.index)
    for seed in range(options["seed"] + 1, options["seed"] + 1 + count):
        root = project.root / SWEEP_FOLDER / "seeds" / f"seed-{seed}"
        root.parent.mkdir(parents=True, exist_ok=True)
        if not root.exists():
            progress.line(f"simulating seed {seed}")
            given: dict[str, Any] = {"seed": seed}
            settings = [*_flat({k: v for k, v in options.items() if k not in ("seed", *_NAMED)})]
            given |= {name: options[name] for name in _NAMED}
            photos = _photo_options(project.root)
            if photos is not None:
                given[_PHOTOS] = photos[_PHOTOS]
                rest = {k: v for k, v in photos.items() if k not in ("seed", "size", _PHOTOS)}
                settings += _flat(rest, _PHOTOS)
            simulate_project(
                root, given=given, settings=settings, preset=project.file.preset, progress=progress
            )
        other = Project(root)
        draw_masks_again(project, other)
        own = {stage: dict(table) for stage, table in project.settings(request.overrides).items()}
        run_pipeline(pipeline, other, RunRequest(last=last, overrides=own), progress)
        yield other, seed


def draw_masks_again(project: Project, other: Project) -> None:
    """Give a simulation masks to learn from, of what a user has drawn of one like it.

    They are the truth's, for nobody draws on the other.
    """
    for drawn in project.input_paths("training_masks"):
        for truth in ("truth_scan_masks", "truth_object"):
            path = other.store.path(truth, drawn.stem)
            if path.is_file():
                folder = mask_folder(other.root, "training")
                folder.mkdir(parents=True, exist_ok=True)
                copyfile(path, folder / drawn.name)


def _photo_options(root: Path) -> dict[str, Any] | None:
    """What the photographs were simulated with, None where there are none."""
    path = root / "truth" / "photos" / "photos.json"
    if not path.is_file():
        return None
    return dict(json.loads(path.read_text(encoding="utf-8"))["options"])


def _flat(options: Mapping[str, Any], before: str = "") -> list[str]:
    """Nested options as ``a.b=value`` texts; what is not set is left out."""
    texts = []
    for name, value in options.items():
        whole = f"{before}.{name}" if before else name
        if isinstance(value, Mapping):
            texts += _flat(value, whole)
        elif value is not None:
            texts.append(f"{whole}={json.dumps(value)}")
    return texts


def _twin(point: Mapping[str, Any], points: Sequence[dict[str, Any]]) -> dict[str, Any] | None:
    same = ("stage", "measure", "knobs")
    return next((one for one in points if all(one[key] == point[key] for key in same)), None)


def _statistics(points: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    measured = [point for point in points if point["error"] is not None]
    told: dict[str, Any] = {"count": len(measured)}
    for name, key in (("error", "error"), ("wall", "wall_s")):
        values = [point[key] for point in measured]
        told[f"{name}_mean"] = float(np.mean(values)) if values else None
        told[f"{name}_std"] = float(np.std(values, ddof=1)) if len(values) > 1 else None
    return told


def _checked(
    choice: Mapping[str, Any], points: Sequence[dict[str, Any]], budget: Budget
) -> dict[str, Any]:
    """Whether a recommendation keeps on another seed what it was chosen for."""
    own = [p for p in points if (p["stage"], p["measure"]) == (choice["stage"], choice["measure"])]
    own = [p for p in own if p["error"] is not None]
    point = next((p for p in own if p["knobs"] == choice["knobs"]), None)
    if choice["knobs"] is None or point is None:
        return {"holds": None, "told": "nothing was recommended, or it could not be measured"}
    if choice["how"] == "knee":
        costs = [one["error"] * one[cost_of(budget)] for one in own]
        factor = point["error"] * point[cost_of(budget)] / max(min(costs), 1e-300)
        return {
            "holds": factor <= _KNEE_SLACK,
            "told": f"error × time is {factor:.2f} × the least of this seed",
        }
    kept = (budget.error is None or point["error"] <= budget.error) and (
        budget.seconds is None or point["wall_s"] <= _TIME_SLACK * budget.seconds
    )
    return {
        "holds": kept,
        "told": f"error {point['error']:.4g} {point['error_unit']} in {point['wall_s']:.3g} s",
    }
