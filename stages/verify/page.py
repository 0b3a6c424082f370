"""The report's chapter on the page, where it was measured."""

from __future__ import annotations

from typing import TYPE_CHECKING

from workbench.metrics import Metric
from workbench.pipeline.stage import Products

if TYPE_CHECKING:
    from workbench.verification.report_content import Section


def page_chapter(products: Products) -> tuple[tuple[Section, ...], list[Metric]]:
    """The chapter and its metrics; none where the page was not measured."""
    from workbench.verification.page_sections import page_metrics, page_section

    told = products.load_if_there("page_measures")
    if told is None:
        return (), []
    return (page_section(told),), page_metrics(told)
