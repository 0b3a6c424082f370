"""What the stage has to say of the flash and of the colours."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from workbench.metrics import Metric

_NAMED = 5

if TYPE_CHECKING:
    from stages.color.anchoring import Level
    from stages.color.flashing import FoundFlash
    from workbench.color.blending import Blending
    from workbench.color.blending_seams import SeamSteps
    from workbench.color.inpainting import Inpainting


def flash_document(
    flash: FoundFlash, gains: Mapping[str, float], unlit: Sequence[str], level: Level, space: str
) -> dict[str, Any]:
    """``flash.json``: the light, how sure it is, and what was left out.

    Parameters
    ----------
    gains : photograph → value of a white diffuser that gets light 1.
    unlit : photographs without flash.
    space : the colours' working space.
    """
    told: dict[str, Any] = {
        "way": flash.way,
        "reason": flash.reason or None,
        "space": space,
        "level": level.words,
        "gains": dict(gains),
        "without_flash": list(unlit),
        "light": None,
        "estimate": None,
    }
    light, estimate = flash.light, flash.estimate
    if light is not None:
        told["light"] = light.document()
    if estimate is not None:
        told["estimate"] = {
            "position_sigma_m": estimate.position_sigma.tolist(),
            "condition": estimate.condition,
            "terms": [
                {
                    "term": trial.term,
                    "kept": trial.kept,
                    "spread_without": trial.without,
                    "spread_with": trial.with_term,
                    "certainty": trial.certainty,
                }
                for trial in estimate.trials
            ],
            "scatter_as_shot": _plain(estimate.scatter_as_shot),
            "scatter_with_gains": _plain(estimate.scatter_with_gains),
            "scatter": _plain(estimate.scatter),
            "scatter_held_out": _plain(estimate.scatter_held_out),
            "converged": estimate.converged,
        }
    return told


def flash_metrics(flash: FoundFlash) -> list[Metric]:
    """Where the flash is and what taking it out does; nothing where it was left out."""
    light, estimate = flash.light, flash.estimate
    if light is None:
        return []
    right, down, forward = light.position_in_camera
    metrics = [
        Metric("flash_right", float(right), "m", "Middle of the flash, right of the lens."),
        Metric("flash_down", float(down), "m", "Middle of the flash, below the lens."),
        Metric("flash_forward", float(forward), "m", "Middle of the flash, before the lens."),
        Metric("roughness", float(np.degrees(light.roughness_rad)), "deg",
               "Roughness of the surface that the correction takes (Oren and Nayar)."),
    ]  # fmt: skip
    if estimate is None:
        return metrics
    return [
        *metrics,
        Metric("flash_sigma", float(np.linalg.norm(estimate.position_sigma)), "m",
               "Standard deviation of the flash's place."),
        Metric("scatter_as_shot", 100.0 * estimate.scatter_as_shot, "%",
               "Spread of a place's luminance over the photographs, as photographed."),
        Metric("scatter_corrected", 100.0 * estimate.scatter, "%",
               "The same, the flash taken out."),
    ]  # fmt: skip


def color_metrics(
    blending: Blending,
    inpainting: Inpainting | None,
    colors: NDArray[np.float64],
    seams: SeamSteps,
) -> list[Metric]:
    """How much has colour, whence, and how even it is.

    Parameters
    ----------
    colors : (n, 3), inpainted too.
    """
    told = blending.weights > 0.0
    painted = np.isfinite(colors).all(axis=1) & ~told
    scatter = blending.scatter[np.isfinite(blending.scatter)]
    count = blending.photos[told]
    metrics = [
        Metric("photographed_share", 100.0 * float(told.mean()), "%",
               "Vertices whose colour photographs tell."),
        Metric("inpainted_share", 100.0 * float(painted.mean()), "%",
               "Vertices whose colour is spread from those around."),
        Metric("photos_per_vertex", float(np.median(count)) if len(count) else 0.0, "",
               "Photographs that tell a vertex, median."),
        Metric("blended_scatter", 100.0 * float(np.median(scatter)) if len(scatter) else np.nan,
               "%", "Spread of a vertex's level over the photographs blended, median."),
        Metric("doubted_share", 100.0 * blending.doubted, "%",
               "Of the photographs' weight, what did not count because it differed."),
        Metric("seam_step", 100.0 * seams.seam, "%",
               "What colours step at borders of photographs beyond what one photograph shows."),
        Metric("step_noise", 100.0 * seams.noise, "%",
               "What one photograph steps from vertex to vertex beyond the others."),
    ]  # fmt: skip
    if inpainting is not None and inpainting.unknowns:
        metrics += [
            Metric("inpaint_factor", inpainting.factor, "",
                   "By what a multigrid cycle reduced the residual, on average."),
            Metric("inpaint_cycles", inpainting.cycles, "", "Multigrid cycles."),
            Metric("inpaint_error", inpainting.error, "",
                   "How far a spread colour may be from the exact solution, linear."),
        ]  # fmt: skip
    return metrics


def color_warnings(
    flash: FoundFlash, unlit: Sequence[str], level: Level, inpainting: Inpainting | None
) -> tuple[str, ...]:
    """What the user should know before the colours are relied on."""
    warnings = []
    if flash.way == "at the lens":
        warnings.append(f"the flash is taken to be at the lens: {flash.reason}")
    if flash.way == "left out" and not unlit:
        warnings.append(f"colours keep the light they were photographed in: {flash.reason}")
    if flash.estimate is not None:
        warnings += flash.estimate.warnings
    if unlit:
        warnings.append(
            f"{len(unlit)} photographs were taken without flash and keep their light: "
            + ", ".join(unlit[:_NAMED])
            + (" …" if len(unlit) > _NAMED else "")
        )
    if level.gain == 1.0 and flash.light is not None:
        warnings.append(f"the colours' level is {level.words}")
    if inpainting is not None and not inpainting.converged:
        warnings.append(
            f"inpainting had not settled after {inpainting.cycles} cycles: a colour may be "
            f"off by {inpainting.error:.1g}"
        )
    return tuple(warnings)


def _plain(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None
