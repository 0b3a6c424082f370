"""All stiff cases, those that are wanted of them, and the table that comes of running them."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterable, Sequence
from fnmatch import fnmatchcase
from typing import Any

import numpy as np
from threadpoolctl import threadpool_limits  # type: ignore[import-untyped]

from workbench.errors import SettingsError
from workbench.stability.calibration_cases import CALIBRATION_CASES
from workbench.stability.camera_cases import CAMERA_CASES
from workbench.stability.case import Case, Row, tried
from workbench.stability.diffusion_cases import DIFFUSION_CASES
from workbench.stability.flash_cases import FLASH_CASES
from workbench.stability.mask_cases import MASK_CASES
from workbench.stability.number_cases import NUMBER_CASES
from workbench.stability.point_cases import POINT_CASES
from workbench.stability.pose_graph_cases import POSE_GRAPH_CASES
from workbench.stability.registration_cases import REGISTRATION_CASES
from workbench.stability.surface_cases import SURFACE_CASES
from workbench.stability.texture_cases import TEXTURE_CASES
from workbench.stability.voxel_cases import VOXEL_CASES

ALL_CASES: tuple[Case, ...] = (
    *REGISTRATION_CASES,
    *POSE_GRAPH_CASES,
    *SURFACE_CASES,
    *DIFFUSION_CASES,
    *FLASH_CASES,
    *CALIBRATION_CASES,
    *TEXTURE_CASES,
    *VOXEL_CASES,
    *CAMERA_CASES,
    *POINT_CASES,
    *MASK_CASES,
    *NUMBER_CASES,
)


def chosen(*, quick: bool = False, only: str | None = None) -> tuple[Case, ...]:
    """The cases of the table.

    Parameters
    ----------
    quick : those alone that take next to no time.
    only : part of their names, or a pattern with ``*`` and ``?`` for whole names.

    Raises
    ------
    SettingsError
        No case has such a name.
    """
    cases = tuple(case for case in ALL_CASES if case.quick or not quick)
    if only is None:
        return cases
    pattern = only if set(only) & set("*?") else f"*{only}*"
    found = tuple(case for case in cases if fnmatchcase(case.name, pattern))
    if not found:
        domains = sorted({case.name.partition("/")[0] for case in cases})
        raise SettingsError(
            f"There is no stiff case {only!r}" + (" among the quick ones" if quick else ""),
            expected="part of a name, such as " + ", ".join(f"{name}/" for name in domains),
            fix="choose one of these, or leave --only out",
        )
    return found


def rows_of(cases: Sequence[Case], on_case: Callable[[], None] = lambda: None) -> list[Row]:
    """Run the cases one after another; one thread, so that times compare.

    Parameters
    ----------
    on_case : called after every case.
    """
    rows = []
    with warnings.catch_warnings(), np.errstate(all="ignore"), threadpool_limits(1):
        # What matters of them is in the values.
        warnings.simplefilter("ignore")
        for case in cases:
            rows.append(tried(case))
            on_case()
    return rows


def table_document(rows: Iterable[Row], *, quick: bool) -> dict[str, Any]:
    """The table as plain data, for JSON and reports."""
    plain = [row.as_dict() for row in rows]
    return {
        "quick": quick,
        "right": sum(row["outcome"] == "right within bound" for row in plain),
        "refused": sum(row["outcome"] == "refused" for row in plain),
        "wrong": sum(not row["passed"] for row in plain),
        "seconds": sum(row["seconds"] for row in plain),
        "cases": plain,
    }
