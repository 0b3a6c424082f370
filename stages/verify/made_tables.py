"""The report's chapters on what commands of their own measured, where they did."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any

from workbench.metrics import Metric
from workbench.pipeline.stage import Products

if TYPE_CHECKING:
    from workbench.verification.report_content import Section

Chapter = tuple[tuple["Section", ...], list[Metric]]


def page_chapter(products: Products) -> Chapter:
    """What the page costs (``publish --measure``)."""
    from workbench.verification.page_sections import page_metrics, page_section

    return _chapter(products, "page_measures", page_section, page_metrics)


def sweep_chapter(products: Products) -> Chapter:
    """Error against run time (``sweep``)."""
    from workbench.verification.sweep_sections import sweep_metrics, sweep_section

    return _chapter(products, "sweep_points", sweep_section, sweep_metrics)


def stability_chapter(products: Products) -> Chapter:
    """Stiff and extreme cases (``stability``)."""
    from workbench.verification.stability_sections import stability_metrics, stability_section

    return _chapter(products, "stability_table", stability_section, stability_metrics)


def fault_chapter(products: Products) -> Chapter:
    """Kills and other faults (``make faults``)."""
    from workbench.verification.fault_sections import fault_metrics, fault_section

    return _chapter(products, "fault_table", fault_section, fault_metrics)


def _chapter(
    products: Products,
    artefact: str,
    section: Callable[[Mapping[str, Any]], Section],
    metrics: Callable[[Mapping[str, Any]], list[Metric]],
) -> Chapter:
    """The chapter and its metrics; none where there is no table."""
    told = products.load_if_there(artefact)
    return ((), []) if told is None else ((section(told),), metrics(told))
