"""What is to be said of development, gathered from the project."""

from __future__ import annotations

from typing import TYPE_CHECKING

from workbench.pipeline.stage import Products

if TYPE_CHECKING:
    from workbench.verification.report_content import Section


def development_chapter(products: Products) -> tuple[Section, ...]:
    """The section on colour and exposure, where photographs were developed."""
    from workbench.verification.develop_sections import development_section

    inventory = products.load_if_there("photo_inventory")
    calibration = products.load_if_there("color_calibration")
    if inventory is None or calibration is None:
        return ()
    chart = calibration.get("chart")
    picture = None
    if chart in products.items("developed_photos"):
        picture = products.load("developed_photos", chart)
    return (development_section(inventory, calibration, picture),)
