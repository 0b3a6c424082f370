"""The chapter on sweeps: plots for every stage, the table, and what to take."""

from __future__ import annotations

import pytest

from workbench.verification.sweep_sections import sweep_metrics, sweep_section


def point(depth: int, error: float | None, wall: float, **changed) -> dict:
    return {
        "stage": "infill", "measure": "infill", "knobs": {"depth": depth}, "error": error,
        "error_unit": "m", "told": "mean distance", "wall_s": wall, "wall_spread": 0.0,
        "cpu_s": wall, "peak_rss_bytes": 2**30, "repeats": 1, "default": False, "pareto": True,
        "recommended": False, "reason": "",
    } | changed  # fmt: skip


def told(*points: dict, **choice) -> dict:
    return {
        "points": list(points),
        "recommended": [
            {"stage": "infill", "measure": "infill", "how": "knee", "reason": "the knee",
             "knobs": {"depth": 7}} | choice
        ],
        "left_out": {"mask": "no training masks"},
        "noise": {"told": "The machine was steady."},
    }  # fmt: skip


POINTS = (
    point(6, 0.004, 1.0),
    point(7, 0.001, 2.0, recommended=True),
    point(8, 0.0009, 9.0, default=True),
    point(9, None, 0.0, pareto=False, reason="it needs too much memory"),
)


def test_errors_are_drawn_and_listed_and_the_advice_is_said():
    section = sweep_section(told(*POINTS))
    paragraph, left_out, plot, table = section.blocks
    assert "steady" in paragraph.text
    assert left_out.items == ("mask: left out, no training masks",)
    # Millimetres, for metres have too many zeros; what was not measured is not drawn.
    assert plot.data["Error (mm)"] == pytest.approx([4.0, 1.0, 0.9])
    assert plot.data["Wall time (s)"] == [1.0, 2.0, 9.0]
    assert plot.data["Peak memory (GiB)"] == [1.0, 1.0, 1.0]
    assert [row[0] for row in table.rows] == [1, 2, 3, 4]
    assert [row[2] for row in table.rows] == pytest.approx([4.0, 1.0, 0.9, None], abs=1e-9)
    assert table.rows[1][-1] == "recommended"
    assert table.rows[3][-1] == "it needs too much memory"
    assert "Recommended: depth 7; the knee." in table.caption


def test_seeds_show_mean_and_deviation_and_whether_advice_holds():
    seeds = {"count": 3, "error_mean": 0.002, "error_std": 0.0005}
    section = sweep_section(
        told(
            *(one | {"seeds": seeds} for one in POINTS),
            checked=[{"seed": 2, "holds": True, "told": ""},
                     {"seed": 3, "holds": False, "told": "1.4 × the least"}],
        )
    )  # fmt: skip
    table = section.blocks[-1]
    assert table.rows[0][3:5] == pytest.approx((2.0, 0.5))
    assert "holds on 1 of 2 other seeds (seed 3: 1.4 × the least)" in table.caption


def test_a_stage_whose_error_nobody_knows_says_so():
    section = sweep_section(told(point(6, None, 1.0, reason="nothing to compare"), knobs=None))
    assert "nothing to compare" in section.blocks[-1].text


def test_metrics_count_settings_and_how_many_in_force_are_on_the_front():
    values = {metric.name: metric.value for metric in sweep_metrics(told(*POINTS))}
    assert values == {"sweep_settings": 4, "sweep_on_front": 1}
