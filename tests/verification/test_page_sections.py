"""The chapter on the page says what was measured, and what went wrong."""

from __future__ import annotations

import pytest

from workbench.verification.page_sections import page_metrics, page_section


def form(mode: str, **changed) -> dict:
    step = {
        "frame_ms": 20.0, "calls": 3, "items": 1000, "card_bytes": 4_000_000,
        "uploaded_bytes": 6_000_000, "read_bytes": 5_000_000, "requests": 7,
    }  # fmt: skip
    path = [step | {"frame_ms": 10.0 * k} for k in (1, 2, 9)]
    return {
        "mode": mode, "label": mode.capitalize(), "file_bytes": 9_000_000, "first_s": 0.5,
        "first_bytes": 100_000, "full_s": 2.5, "full_bytes": 3_000_000, "path": path,
        "end_card_bytes": 4_000_000,
        "compared": [{"headless": v, "rays": 0.9} for v in (0.999, 0.985, 0.99)],
        "errors": [
            {"pixel_error": 1.0, "frame_ms": 20.0, "card_bytes": 1, "error": 0.01},
            {"pixel_error": 4.0, "frame_ms": 5.0, "card_bytes": 1, "error": 0.08},
        ],
        "told": [],
    } | changed  # fmt: skip


def told(*forms: dict) -> dict:
    return {
        "card": "ANGLE (SwiftShader)", "width": 640, "height": 480, "budget_bytes": 8_000_000,
        "patience_s": 0.5, "forms": list(forms),
    }  # fmt: skip


def test_tables_hold_what_was_measured():
    section = page_section(told(form("surfels"), form("graph", errors=[])))
    said, loading, path, likeness, along, errors = section.blocks
    assert "the processor" in said.text
    assert loading.rows[0][0] == "Surfels"
    assert loading.rows[0][1:] == pytest.approx((9.0, 0.5, 0.1, 2.5, 3.0, 5.0, 7))
    assert path.rows[0][1:] == pytest.approx((20.0, 90.0, 3.0, 1000.0, 4.0, 4.0, 2.0))
    assert likeness.rows[1] == ("Graph", 0.999, 0.985, 0.99, 0.9, 0.9, 0.9)
    assert len(along.plots) == 2
    # A form without levels of detail has no error to allow.
    assert list(errors.data) == ["Surfels"]
    assert [row["error"] for row in errors.data["Surfels"]] == [0.01, 0.08]


def test_what_went_wrong_and_what_is_over_the_budget_is_told():
    broken = form("cloud", told=["a chunk is damaged"], end_card_bytes=9_000_000)
    section = page_section(told(broken))
    (problems,) = (block for block in section.blocks if block.kind == "list")
    assert problems.tone == "attention"
    assert problems.items[0] == "Cloud: a chunk is damaged"
    assert "9" in problems.items[1]
    assert "8" in problems.items[1]


def test_metrics_take_the_least_agreement_and_the_median_frame():
    metrics = {metric.name: metric for metric in page_metrics(told(form("voxels")))}
    assert metrics["page_voxels_agreement"].value == pytest.approx(0.985)
    assert metrics["page_voxels_frame"].value == 20.0
    assert metrics["page_voxels_first_bytes"].unit == "bytes"
