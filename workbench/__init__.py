"""The scan workbench: from range scans and photographs to a verified model."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from workbench.project.project import Project

__all__ = ["Project"]


def __getattr__(name: str) -> object:
    # Lazy, so that a kernel can be imported without the project's dependencies.
    if name == "Project":
        from workbench.project.project import Project

        return Project
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
