from __future__ import annotations

import doctest
import json
import re
from html.parser import HTMLParser

import numpy as np
import pytest

import workbench.verification.report
from workbench.metrics import Metric
from workbench.verification.coverage_sections import FilledByPhotographs, measured_share
from workbench.verification.quantities import without_scale
from workbench.verification.record_sections import stage_metrics
from workbench.verification.report import report_html
from workbench.verification.report_content import (
    Card,
    Cards,
    Column,
    LegendEntry,
    Paragraph,
    Picture,
    PictureRow,
    ReportContent,
    Section,
    StageMetric,
    Table,
    TextList,
)
from workbench.verification.scan_report import build_scan_report

VOID = {"meta", "img", "br", "link", "hr", "input", "base", "source"}


class Page(HTMLParser):
    """Tags, attributes and words of a page; raises when tags do not nest."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.open: list[str] = []
        self.tags: list[tuple[str, dict[str, str]]] = []
        self.words: list[str] = []
        self.feed(text)
        self.close()
        assert not self.open

    def handle_starttag(self, tag, attrs):
        self.tags.append((tag, dict(attrs)))
        if tag not in VOID:
            self.open.append(tag)

    def handle_startendtag(self, tag, attrs):
        self.tags.append((tag, dict(attrs)))

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        if self.open and self.open[-1] not in ("style", "title"):
            self.words.append(data)

    @property
    def text(self) -> str:
        return re.sub(r"\s+", " ", " ".join(self.words).replace("\u202f", ""))


@pytest.fixture(scope="module")
def surface(sphere):
    """A sphere of 5 cm with a cap that was infilled."""
    mesh = sphere(radius=0.05, subdivisions=4)
    height = mesh.vertices[:, 2]
    return mesh.with_attributes(
        provenance=(height < -0.03).astype(np.uint8),
        distance_to_samples_m=1e-5 * (1 + np.cos(200 * height)),
    )


@pytest.fixture(scope="module")
def full(records, surface, sphere) -> ReportContent:
    rng = np.random.default_rng(3)
    return build_scan_report(
        records,
        surface,
        project_name="Bust <script>alert('x')</script> & \"co\"",
        date="2025-03-04T10:09:12+00:00",
        residuals={
            "before_m": np.abs(rng.normal(size=2000)) * 1e-3,
            "after_m": np.abs(rng.normal(size=2000)) * 1e-4,
            "samples_to_surface_m": np.abs(rng.normal(size=2000)) * 5e-5,
        },
        overlap=(["front", "back <i>"], np.array([[1, 0.4], [0.3, 1]])),
        samples_per_scan={"front": 1200, "back <i>": 800},
        truth=sphere(radius=0.0501, subdivisions=4),
        reference_name="simulated ball",
        citations=["A. Author: A work. 2020. doi:10.1000/182"],
        reproducibility="The same files give the same result.",
        picture_width_px=120,
    )


@pytest.fixture(scope="module")
def page(full) -> Page:
    return Page(report_html(full))


def test_the_page_needs_no_network_and_no_script(full):
    html = report_html(full)
    addresses = set(re.findall(r"https?://[^\s\"'<>)]+", html))
    assert addresses <= {"http://www.w3.org/2000/svg", "http://www.w3.org/1999/xlink"}
    page = Page(html)
    assert not {"script", "link", "iframe", "object", "base"} & {tag for tag, _ in page.tags}
    for tag, attributes in page.tags:
        assert not any(name.startswith("on") for name in attributes), tag
        if "src" in attributes:
            assert attributes["src"].startswith("data:image/png;base64,")
        if "href" in attributes or "xlink:href" in attributes:
            assert (attributes.get("href") or attributes["xlink:href"]).startswith("#")
    style = html[html.index("<style>") : html.index("</style>")]
    assert "url(" not in style
    assert "@import" not in style


def test_names_are_text_never_markup(full, page):
    html = report_html(full)
    assert "<script" not in html
    assert "<i>" not in html
    assert "&lt;script&gt;" in html
    assert "few <samples>" in page.text
    assert "back <i>" in page.text


def test_ids_are_unique_and_contents_links_find_their_section(page):
    ids = [attributes["id"] for _, attributes in page.tags if "id" in attributes]
    assert len(ids) == len(set(ids))
    links = [a["href"][1:] for tag, a in page.tags if tag == "a"]
    assert len(links) == sum(tag == "section" for tag, _ in page.tags)
    assert set(links) <= set(ids)


def test_pictures_have_alternative_text(page):
    pictures = [attributes for tag, attributes in page.tags if tag == "img"]
    # Cover, and four sides of: shape, provenance, distance to samples, deviation from truth.
    assert len(pictures) == 1 + 4 * 4
    assert all(attributes["alt"] for attributes in pictures)


def test_json_and_page_tell_the_same_numbers(full):
    plain = json.loads(json.dumps(full.as_dict(), allow_nan=False))
    text = Page(report_html(full)).text
    assert plain["project"] == full.project_name
    checked = 0
    for section, told in zip(full.sections, plain["sections"], strict=True):
        assert section.title == told["title"]
        for block, entry in zip(section.blocks, told["blocks"], strict=True):
            if isinstance(block, Table):
                for row in entry["rows"]:
                    for column, cell in zip(block.columns, row, strict=True):
                        shown = re.sub(r"\s+", " ", column.shown(cell).replace("\u202f", ""))
                        assert shown in text
                        checked += isinstance(cell, int | float)
            if isinstance(block, Cards):
                for card in entry["cards"]:
                    assert re.sub(r"\s+", " ", card["value"]) in text
                    checked += 1
    assert checked > 40
    metrics = {(entry["stage"], entry["name"]): entry for entry in plain["metrics"]}
    rms = metrics["register", "residual_rms"]
    assert rms["value"] == 8.125e-5
    assert rms["bound"] == ["<=", 2e-4]
    assert Column("").shown(rms["value"]) in text


def test_the_same_content_gives_the_same_bytes(full):
    assert report_html(full) == report_html(full)
    assert json.dumps(full.as_dict()) == json.dumps(full.as_dict())


def cards_of(content: ReportContent) -> dict[str, Card]:
    return {card.label: card for card in content.sections[0].blocks[0].cards}


def test_cards_say_what_the_model_is(full, surface):
    cards = cards_of(full)
    assert cards["Watertight"].value == "yes"
    assert cards["Watertight"].tone == "good"
    # A cap of a sphere: its share of the area is its share of the height, here 1 / 5.
    assert measured_share(surface) == pytest.approx(0.8, abs=0.01)
    assert cards["Measured"].number == pytest.approx(80, abs=1)
    assert cards["Warnings"].tone == "attention"
    assert cards["Distance from truth"].number == pytest.approx(1e-4, rel=0.1)
    assert cards["Size"].value.replace("\u00a0", " ") == "100 × 100 × 100 mm"


def test_what_photographs_filled_is_told_apart(records, surface):
    filled = FilledByPhotographs(1234, 3, surface.vertices[:, 2] > 0.03)
    content = build_scan_report(
        records[:1],
        surface,
        project_name="p",
        date="2025-03-04",
        samples_per_scan={"a": 5000, "b": 4000},
        filled=filled,
        picture_width_px=160,
    )
    assert content.lead.replace("\u202f", "").startswith(
        "9000 samples of 2 range scans, and 1234 of 3 photographs where the scans have none"
    )
    row = next(
        block
        for section in content.sections
        for block in section.blocks
        if isinstance(block, PictureRow) and len(block.legend) == 3
    )
    assert [entry.label for entry in row.legend] == [
        "measured by scans",
        "by photographs",
        "infilled",
    ]
    # A fifth of the sphere each, above and below, and blue only above.
    front = row.pictures[0].pixels.astype(int)
    blue = front[..., 2] - front[..., 0] > 30
    assert blue.any()
    assert not blue[len(blue) // 2 :].any()
    table = next(
        block
        for section in content.sections
        if section.title == "Coverage"
        for block in section.blocks
        if isinstance(block, Table)
    )
    shares = {name: share for name, _, share in table.rows}
    assert shares == pytest.approx(
        {"measured by scans": 60, "measured by photographs alone": 20, "infilled": 20}, abs=1.5
    )


def test_an_opening_is_told(records, surface):
    opened = surface.keep_triangles(np.arange(len(surface.triangles)) > 0)
    content = build_scan_report(
        records[:1], opened, project_name="p", date="2025-03-04", picture_width_px=60
    )
    card = cards_of(content)["Watertight"]
    assert (card.value, card.tone) == ("no", "attention")
    assert "3 edges lie at an opening" in card.sentence


def test_missing_parts_are_left_out_and_said(records, sphere):
    content = build_scan_report(
        records[:1],
        sphere(subdivisions=3),
        project_name="One scan",
        date="2025-03-04",
        samples_per_scan={"only": 10},
        picture_width_px=60,
    )
    text = Page(report_html(content)).text
    assert "There is one scan only, so that there was nothing to align." in text
    assert "A single scan has no overlap." in text
    assert "For this object no independent truth is known." in text
    assert "No stage had anything to warn of." in text
    assert "No stage was left out." in text
    assert "4 March 2025" in text
    titles = [section.title for section in content.sections]
    assert "Reproducing and citing" not in titles


def test_stages_left_out_tell_why(page):
    assert "no photographs" in page.text
    assert "Stages this project did not need." in page.text


def test_an_interrupted_stage_is_shown_without_numbers(records, sphere):
    broken = [
        *records,
        {"stage": "export", "state": "failed", "started": "2025-03-04T10:05:00+00:00"},
    ]
    content = build_scan_report(
        broken, sphere(subdivisions=3), project_name="p", date="2025-03-04", picture_width_px=60
    )
    assert "Not finished: export." in Page(report_html(content)).text


def test_further_sections_of_other_stages_are_shown():
    pixels = np.zeros((4, 6, 3), np.uint8)
    metric = StageMetric("color", Metric("seam", 1.5, "%", "Seam."))
    section = Section(
        "Photographs",
        "Intro.",
        (
            PictureRow((Picture(pixels, "one", "alt"),), "Row", (LegendEntry((1, 2, 3), "kept"),)),
            Table((Column("Name"), Column("Value", "px", 2)), (("a", 1.23456), ("b", None))),
            Paragraph("Text."),
            TextList(("first", "second"), "attention"),
        ),
    )
    content = ReportContent("T", "P", "soon", "Lead.", (section,), (metric,))
    page = Page(report_html(content))
    for words in ("Photographs", "kept", "1.23", "–", "Text.", "second", "soon", "(px)"):
        assert words in page.text
    assert ("i", {"style": "background: #010203"}) in page.tags


def test_a_row_must_fit_its_columns():
    with pytest.raises(ValueError, match="2 cells under 1 columns"):
        Table((Column("a"),), ((1, 2),))


def test_metrics_of_all_stages_are_collected(records):
    assert [(entry.stage, entry.metric.name) for entry in stage_metrics(records)] == [
        ("register", "residual_rms"),
        ("infill", "watertight"),
    ]


def test_doctests_hold():
    assert doctest.testmod(workbench.verification.report).failed == 0


def test_without_scale_no_length_is_in_metres(records, surface):
    measured = np.abs(np.random.default_rng(3).normal(size=2000)) * 5e-5
    with without_scale():
        content = build_scan_report(
            records,
            surface,
            project_name="A jug",
            date="2025-03-04T10:09:12+00:00",
            residuals={"samples_to_surface_m": measured},
            samples_per_scan={"photo_1": 700, "photo_2": 300},
            of_photographs=True,
            picture_width_px=40,
        )
    page = Page(report_html(content))
    assert not re.search(r"\d\u00a0?\s?(m|mm|µm|m²)\b", page.text)
    assert "(mm)" not in page.text
    assert "u/1000" in page.text
    cards = {card["label"]: card for card in content.as_dict()["sections"][0]["blocks"][0]["cards"]}
    assert cards["Scale"]["value"] == "no scale"
    assert cards["Typical deviation"]["unit"] == "u"
    assert all(entry.metric.unit not in ("m", "mm") for entry in content.metrics)
    # Photographs are not called scans.
    assert "2 photographs" in content.lead
    coverage = next(one for one in content.sections if one.title == "Coverage")
    assert "photograph" in coverage.intro
    assert "scan" not in json.dumps([coverage.intro, coverage.blocks[0].plots[0].caption])
