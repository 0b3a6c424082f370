from __future__ import annotations

from pathlib import Path

import pytest
from fake_pipeline import PIPELINE, FuseOptions

from stages.main import PIPELINE as REAL
from workbench.errors import InputError
from workbench.pipeline.reference import (
    option_rows,
    options_table,
    stage_table,
    with_generated_blocks,
)

README = Path(__file__).resolve().parents[2] / "README.md"
BEGIN, END = "<!-- begin: {} -->", "<!-- end: {} -->"


def test_every_option_is_told_with_default_bounds_and_meaning():
    assert option_rows(FuseOptions) == [
        ("thinning", "0.5", "number ≥ 0.0 and ≤ 10.0", "Thinning | or none."),
        ("depth", "auto", "whole number or `auto`", "Depth."),
        ("window.rows", "3", "whole number ≥ 1 and ≤ 9", "Rows."),
        ("window.cols", "3", "whole number ≥ 1 and ≤ 9", "Columns."),
    ]


def test_the_tables_are_markdown_whatever_the_words():
    for table in (stage_table(PIPELINE), options_table(PIPELINE), options_table(REAL)):
        rows = table.splitlines()
        bars = [row.replace("\\|", "").count("|") for row in rows]
        assert len(set(bars)) == 1
    assert "Thinning \\| or none." in options_table(PIPELINE)
    assert "| `fuse` | Fuses. | `work/fuse/scans/{item}.npz`" in stage_table(PIPELINE)


@pytest.mark.parametrize("stage", REAL, ids=[stage.name for stage in REAL])
def test_every_real_option_explains_itself(stage):
    for name, default, allowed, meaning in option_rows(stage.options):
        assert default != "", name
        assert allowed not in ("", "any"), name
        assert len(meaning) > 10, name


def test_blocks_are_made_anew_and_the_rest_is_left_alone():
    text = f"# Title\n{BEGIN.format('options')}\nold \\1\n{END.format('options')}\nrest\n"
    once = with_generated_blocks(text, PIPELINE)
    assert once.startswith("# Title\n")
    assert once.endswith("rest\n")
    assert options_table(PIPELINE) in once
    assert "old" not in once
    assert with_generated_blocks(once, PIPELINE) == once
    assert with_generated_blocks("no blocks\n", PIPELINE) == "no blocks\n"
    with pytest.raises(InputError, match="no end"):
        with_generated_blocks(BEGIN.format("stages"), PIPELINE)


def test_the_readme_says_what_the_declarations_say():
    if not README.exists() or BEGIN.format("options") not in README.read_text(encoding="utf-8"):
        pytest.skip("the README has no generated blocks")
    text = README.read_text(encoding="utf-8")
    assert with_generated_blocks(text, REAL) == text, "run: workbench options --readme README.md"
