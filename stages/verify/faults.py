"""The report's chapter on kills and other faults, where a table of them was made."""

from __future__ import annotations

from typing import TYPE_CHECKING

from workbench.metrics import Metric
from workbench.pipeline.stage import Products

if TYPE_CHECKING:
    from workbench.verification.report_content import Section


def fault_chapter(products: Products) -> tuple[tuple[Section, ...], list[Metric]]:
    """The chapter and its metrics; none without a table."""
    from workbench.verification.fault_sections import fault_metrics, fault_section

    told = products.load_if_there("fault_table")
    if told is None:
        return (), []
    return (fault_section(told),), fault_metrics(told)
