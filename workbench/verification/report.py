"""A report as one self-contained page."""

from __future__ import annotations

import base64
import re
from datetime import datetime
from importlib import resources

from workbench.render.shading import jpeg_bytes, png_bytes
from workbench.verification.report_content import Picture, ReportContent

_TEMPLATE = "report.html"
# fmt: off
_MONTHS = [
    "January", "February", "March", "April", "May", "June",
    "July", "August", "September", "October", "November", "December",
]
# fmt: on


def report_html(content: ReportContent) -> str:
    """The page as text.

    It holds all it shows — pictures, drawings, style — and asks nothing of a network or a
    script, so that it can be kept with the model. The same content gives the same bytes.
    """
    from jinja2 import Environment, StrictUndefined

    environment = Environment(
        autoescape=True, undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True
    )
    environment.filters["data_url"] = _data_url
    environment.filters["in_words"] = date_in_words
    environment.filters["css_color"] = lambda rgb: "#{:02x}{:02x}{:02x}".format(*rgb)
    source = resources.files("workbench.verification").joinpath(_TEMPLATE).read_text("utf-8")
    page = environment.from_string(source).render(
        content=content,
        anchors=[f"s{k}-{_slug(section.title)}" for k, section in enumerate(content.sections, 1)],
    )
    return re.sub(r"\n\s*\n+", "\n", page)


def date_in_words(date: str) -> str:
    """An ISO 8601 date, with time and zone where it has them; other text stays as it is.

    Examples
    --------
    >>> date_in_words("2025-03-04T10:09:12Z")
    '4 March 2025, 10:09 UTC'
    """
    try:
        moment = datetime.fromisoformat(date)
    except ValueError:
        return date
    # Month names are spelt out here: those of strftime follow the machine's language.
    words = f"{moment.day} {_MONTHS[moment.month - 1]} {moment.year}"
    if len(date) <= len("2025-03-04"):
        return words
    zone = moment.tzname()
    return f"{words}, {moment:%H:%M}" + (f" {zone}" if zone else "")


def _data_url(picture: Picture) -> str:
    kind, encoded = "png", png_bytes
    if picture.is_photograph:
        kind, encoded = "jpeg", jpeg_bytes
    return f"data:image/{kind};base64," + base64.b64encode(encoded(picture.pixels)).decode("ascii")


def _slug(title: str) -> str:
    return re.sub(r"[^a-z0-9]+", "-", title.lower()).strip("-")
