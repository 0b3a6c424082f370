"""What a report says, apart from how it looks: sections of cards, pictures, plots, tables."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, ClassVar, Literal

import numpy as np
from numpy.typing import NDArray

from workbench.metrics import Metric
from workbench.verification.quantities import MISSING, shown_number

Cell = str | float | int | bool | None
Tone = Literal["plain", "good", "attention"]


@dataclass(frozen=True)
class Card:
    """One finding for a reader in a hurry.

    Attributes
    ----------
    label : what it is about, e.g. ``Watertight``.
    value : the finding with its unit, e.g. ``96.3 % of the area``.
    sentence : what that means, in plain words.
    tone : ``attention`` where the reader should look twice.
    number : the value as a number in ``unit``, for report.json; None when it has none.
    unit : of ``number``.
    """

    label: str
    value: str
    sentence: str
    tone: Tone = "plain"
    number: float | int | bool | None = None
    unit: str = ""

    def as_dict(self) -> dict[str, Any]:
        """Plain data for report.json."""
        plain = {"label": self.label, "value": self.value, "sentence": self.sentence}
        if self.number is None:
            return plain
        return {**plain, "number": json_number(self.number), "unit": self.unit}


@dataclass(frozen=True)
class Cards:
    """A group of cards, shown side by side."""

    kind: ClassVar[str] = "cards"
    cards: tuple[Card, ...]

    def as_dict(self) -> dict[str, Any]:
        """Plain data for report.json."""
        return {"kind": self.kind, "cards": [card.as_dict() for card in self.cards]}


@dataclass(frozen=True)
class Picture:
    """A raster picture.

    Attributes
    ----------
    pixels : (h, w, 3) uint8 sRGB.
    caption : short, shown below.
    alt : what can be seen, for those who cannot.
    is_photograph : grain that need not be kept exactly, which saves nine tenths of its size.
    """

    pixels: NDArray[np.uint8]
    caption: str
    alt: str
    is_photograph: bool = False


@dataclass(frozen=True)
class LegendEntry:
    """A colour (sRGB) and what it stands for."""

    color: tuple[int, int, int]
    label: str


@dataclass(frozen=True)
class PictureRow:
    """Pictures that belong together, with one caption and one legend.

    Attributes
    ----------
    pictures : of one size.
    caption : what they show and how to read it.
    legend : colours by name.
    color_bar : an ``<svg>`` element from `workbench.verification.figures`; trusted.
    most_beside : so many pictures stand side by side at most; further ones below them.
    """

    kind: ClassVar[str] = "pictures"
    pictures: tuple[Picture, ...]
    caption: str
    legend: tuple[LegendEntry, ...] = ()
    color_bar: str | None = None
    most_beside: int = 6

    def as_dict(self) -> dict[str, Any]:
        """Plain data for report.json: captions only."""
        views = [{"caption": picture.caption, "alt": picture.alt} for picture in self.pictures]
        return {"kind": self.kind, "caption": self.caption, "pictures": views}


@dataclass(frozen=True)
class Plot:
    """A diagram.

    Attributes
    ----------
    svg : an ``<svg>`` element from `workbench.verification.figures`; trusted.
    caption : what it shows and how to read it.
    data : the numbers behind it, or a summary of them, for report.json.
    is_wide : whether it takes the width of the page, for several panels.
    """

    kind: ClassVar[str] = "plot"
    svg: str
    caption: str
    data: Mapping[str, Any] = field(default_factory=dict)
    is_wide: bool = False

    def as_dict(self) -> dict[str, Any]:
        """Plain data for report.json."""
        return {"kind": self.kind, "caption": self.caption, "data": _plain(self.data)}


@dataclass(frozen=True)
class PlotRow:
    """Diagrams that are read together, side by side where there is room."""

    kind: ClassVar[str] = "plots"
    plots: tuple[Plot, ...]

    def as_dict(self) -> dict[str, Any]:
        """Plain data for report.json."""
        return {"kind": self.kind, "plots": [plot.as_dict() for plot in self.plots]}


@dataclass(frozen=True)
class Column:
    """A column of a table.

    Attributes
    ----------
    title : heading.
    unit : shown in the heading.
    decimals : of the numbers; None shows four significant digits.
    style : ``code`` for names, paths and hashes; ``wide`` for sentences.
    """

    title: str
    unit: str = ""
    decimals: int | None = None
    style: Literal["plain", "code", "wide"] = "plain"

    def shown(self, cell: Cell) -> str:
        """A cell as text."""
        if isinstance(cell, str):
            return cell
        if cell is None or (isinstance(cell, float) and not math.isfinite(cell)):
            return MISSING
        if self.decimals is None or isinstance(cell, bool):
            return shown_number(cell)
        return f"{cell:,.{self.decimals}f}".replace(",", "\u202f").replace("-", "−")


@dataclass(frozen=True)
class Table:
    """Rows of cells under columns; numbers are right-aligned on their decimals."""

    kind: ClassVar[str] = "table"
    columns: tuple[Column, ...]
    rows: tuple[tuple[Cell, ...], ...]
    caption: str = ""

    def __post_init__(self) -> None:
        for row in self.rows:
            if len(row) != len(self.columns):
                raise ValueError(f"a row of {len(row)} cells under {len(self.columns)} columns")

    def is_numeric(self, column: int) -> bool:
        """Whether a column holds numbers and truth values only, empty cells aside."""
        cells = [row[column] for row in self.rows if row[column] is not None]
        return bool(cells) and all(isinstance(cell, int | float) for cell in cells)

    def as_dict(self) -> dict[str, Any]:
        """Plain data for report.json."""
        columns = [{"title": column.title, "unit": column.unit} for column in self.columns]
        rows = [[_plain(cell) for cell in row] for row in self.rows]
        return {"kind": self.kind, "caption": self.caption, "columns": columns, "rows": rows}


@dataclass(frozen=True)
class Paragraph:
    """Running text."""

    kind: ClassVar[str] = "paragraph"
    text: str

    def as_dict(self) -> dict[str, Any]:
        """Plain data for report.json."""
        return {"kind": self.kind, "text": self.text}


@dataclass(frozen=True)
class TextList:
    """Short texts, one below the other: warnings, references."""

    kind: ClassVar[str] = "list"
    items: tuple[str, ...]
    tone: Tone = "plain"

    def as_dict(self) -> dict[str, Any]:
        """Plain data for report.json."""
        return {"kind": self.kind, "items": list(self.items)}


Block = Cards | PictureRow | Plot | PlotRow | Table | Paragraph | TextList


@dataclass(frozen=True)
class Section:
    """A chapter of the report: title, one or two introducing sentences, blocks."""

    title: str
    intro: str
    blocks: tuple[Block, ...]

    def as_dict(self) -> dict[str, Any]:
        """Plain data for report.json."""
        blocks = [block.as_dict() for block in self.blocks]
        return {"title": self.title, "intro": self.intro, "blocks": blocks}


@dataclass(frozen=True)
class StageMetric:
    """A metric and the stage that measured it."""

    stage: str
    metric: Metric

    def as_dict(self) -> dict[str, Any]:
        """Plain data for report.json and ``workbench verify --json``."""
        return {"stage": self.stage, **self.metric.as_dict()}


@dataclass(frozen=True)
class ReportContent:
    """All a report says.

    Attributes
    ----------
    title : e.g. ``Verification report``.
    project_name : as the user wrote it.
    date : of the run, ISO 8601; passed in, so that the same run gives the same report.
    lead : one or two sentences below the title.
    sections : in reading order.
    metrics : all metrics, for report.json.
    cover : picture beside the title.
    """

    title: str
    project_name: str
    date: str
    lead: str
    sections: tuple[Section, ...]
    metrics: tuple[StageMetric, ...] = ()
    cover: Picture | None = None

    def as_dict(self) -> dict[str, Any]:
        """Plain data for report.json."""
        return {
            "title": self.title,
            "project": self.project_name,
            "date": self.date,
            "lead": self.lead,
            "metrics": [metric.as_dict() for metric in self.metrics],
            "sections": [section.as_dict() for section in self.sections],
        }


def json_number(value: Any) -> float | int | bool | None:
    """A number as JSON knows it: NumPy scalars become Python's, not finite ones None."""
    if isinstance(value, bool | np.bool_):
        return bool(value)
    if isinstance(value, int | np.integer):
        return int(value)
    return float(value) if math.isfinite(value) else None


def _plain(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {str(key): _plain(entry) for key, entry in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(entry) for entry in value]
    if isinstance(value, np.ndarray):
        return [_plain(entry) for entry in value.tolist()]
    if value is None or isinstance(value, str):
        return value
    return json_number(value)
