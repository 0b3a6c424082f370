"""The report's chapter on stiff cases, where a table of them was made."""

from __future__ import annotations

from typing import TYPE_CHECKING

from workbench.metrics import Metric
from workbench.pipeline.stage import Products

if TYPE_CHECKING:
    from workbench.verification.report_content import Section


def stability_chapter(products: Products) -> tuple[tuple[Section, ...], list[Metric]]:
    """The chapter and its metrics; none without a table."""
    from workbench.verification.stability_sections import stability_metrics, stability_section

    told = products.load_if_there("stability_table")
    if told is None:
        return (), []
    return (stability_section(told),), stability_metrics(told)
