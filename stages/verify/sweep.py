"""The report's chapter on error against run time, where settings were tried."""

from __future__ import annotations

from typing import TYPE_CHECKING

from workbench.metrics import Metric
from workbench.pipeline.stage import Products

if TYPE_CHECKING:
    from workbench.verification.report_content import Section


def sweep_chapter(products: Products) -> tuple[tuple[Section, ...], list[Metric]]:
    """The chapter and its metrics; none without a sweep."""
    from workbench.verification.sweep_sections import sweep_metrics, sweep_section

    told = products.load_if_there("sweep_points")
    if told is None:
        return (), []
    return (sweep_section(told),), sweep_metrics(told)
