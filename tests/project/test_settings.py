from __future__ import annotations

from typing import Literal

import pytest
from pydantic import Field

from workbench.errors import SettingsError
from workbench.project import settings
from workbench.project.settings import (
    StageOptions,
    load_preset,
    merged,
    options_for,
    parse_assignment,
    presets,
    suggestion,
)


class Solver(StageOptions):
    tolerance: float = Field(1e-3, gt=0.0)
    threads: int = Field(1, json_schema_extra={"changes_result": False})


class Options(StageOptions):
    depth: int | Literal["auto"] = "auto"
    rings: int = Field(1, ge=0)
    weight: float = 4.0
    closed: bool = True
    shape: tuple[int, int] = (3, 4)
    label: str = ""
    solver: Solver = Solver()
    verbose: bool = Field(False, json_schema_extra={"changes_result": False})


@pytest.mark.parametrize(
    ("text", "tables"),
    [
        ("infill.depth=9", {"infill": {"depth": 9}}),
        (" infill.depth = 9 ", {"infill": {"depth": 9}}),
        ("infill.depth=auto", {"infill": {"depth": "auto"}}),
        ('infill.label="9"', {"infill": {"label": "9"}}),
        ("infill.label=a=b", {"infill": {"label": "a=b"}}),
        ("infill.label=", {"infill": {"label": ""}}),
        ("infill.label=2024-01-31", {"infill": {"label": "2024-01-31"}}),
        ("infill.closed=false", {"infill": {"closed": False}}),
        ("infill.shape=[1, 2]", {"infill": {"shape": [1, 2]}}),
        ("infill.weight=1e-3", {"infill": {"weight": 1e-3}}),
        ("infill.solver.tolerance=0.5", {"infill": {"solver": {"tolerance": 0.5}}}),
    ],
)
def test_an_assignment_becomes_tables(text, tables):
    assert parse_assignment(text) == tables


@pytest.mark.parametrize(
    "text", ["", "=", "depth=3", "infill.depth", ".depth=3", "infill.=3", "a..b=1"]
)
def test_what_is_no_assignment_is_refused(text):
    with pytest.raises(SettingsError, match="not understood") as caught:
        parse_assignment(text)
    assert caught.value.expected == "stage.option=value"


def test_later_layers_win_option_by_option_at_every_depth():
    preset = {"infill": {"depth": 7, "solver": {"tolerance": 0.1, "threads": 2}}}
    project = {"infill": {"rings": 2, "solver": {"tolerance": 0.2}}, "fuse": {}}
    result = merged([preset, project, {"infill": {"depth": 9}}])
    assert result == {
        "infill": {"depth": 9, "rings": 2, "solver": {"tolerance": 0.2, "threads": 2}},
        "fuse": {},
    }
    result["infill"]["solver"]["tolerance"] = 5
    assert preset["infill"]["solver"]["tolerance"] == 0.1


def test_values_keep_their_kind():
    good = {"depth": 9, "weight": 3, "shape": [5, 6], "solver": {"tolerance": 1}}
    options = options_for("infill", Options, {"infill": good})
    assert options == Options(depth=9, weight=3.0, shape=(5, 6), solver=Solver(tolerance=1.0))
    assert options_for("infill", Options, {}) == Options()


@pytest.mark.parametrize(
    ("table", "name", "expected"),
    [
        ({"rings": "3"}, "infill.rings", "integer"),
        ({"rings": True}, "infill.rings", "integer"),
        ({"rings": 2.0}, "infill.rings", "integer"),
        ({"rings": -1}, "infill.rings", "greater than or equal to 0"),
        ({"weight": "3"}, "infill.weight", "number"),
        ({"weight": float("nan")}, "infill.weight", "finite"),
        ({"weight": float("inf")}, "infill.weight", "finite"),
        ({"closed": 1}, "infill.closed", "boolean"),
        ({"closed": "yes"}, "infill.closed", "boolean"),
        ({"label": 3}, "infill.label", "string"),
        ({"shape": [1]}, "infill.shape", ""),
        ({"shape": [1, "x"]}, "infill.shape", "integer"),
        ({"depth": "deep"}, "infill.depth", "integer or Input should be 'auto'"),
        ({"solver": 3}, "infill.solver", ""),
        ({"solver": {"tolerance": 0}}, "infill.solver.tolerance", "greater than 0"),
    ],
)
def test_a_wrong_value_is_told_with_what_is_allowed(table, name, expected):
    with pytest.raises(SettingsError, match="Wrong value") as caught:
        options_for("infill", Options, {"infill": table})
    assert caught.value.message == f"Wrong value for {name}"
    assert expected in caught.value.expected
    assert caught.value.stage == "infill"


@pytest.mark.parametrize(
    ("table", "name", "fix"),
    [
        ({"dept": 3}, "infill.dept", "did you mean 'depth'?"),
        ({"solver": {"tolerence": 3}}, "infill.solver.tolerence", "did you mean 'tolerance'?"),
        ({"solver": {"depth": 3}}, "infill.solver.depth", "`workbench options infill` lists"),
    ],
)
def test_an_unknown_option_is_told_with_the_nearest_in_its_own_group(table, name, fix):
    with pytest.raises(SettingsError) as caught:
        options_for("infill", Options, {"infill": table})
    assert caught.value.message == f"There is no option {name}"
    assert caught.value.fix.startswith(fix)


def test_a_long_value_is_not_told_in_full():
    with pytest.raises(SettingsError) as caught:
        options_for("infill", Options, {"infill": {"rings": "x" * 10_000}})
    assert len(caught.value.found) < 200


def test_options_that_cannot_change_the_result_are_left_out_at_every_depth():
    plain = Options(verbose=True, solver=Solver(threads=8)).result_options()
    assert plain == Options().result_options()
    assert plain["solver"] == {"tolerance": 1e-3}
    assert "verbose" not in plain
    with pytest.raises(Exception, match="frozen"):
        Options().rings = 3


def test_presets_are_known_by_name_and_hold_stages_only(tmp_path, monkeypatch):
    assert {"default", "draft", "statue", "building"} <= set(presets())
    assert load_preset("default") == {}
    with pytest.raises(SettingsError) as caught:
        load_preset("status")
    assert caught.value.fix == "did you mean 'statue'?"
    (tmp_path / "odd.toml").write_text("[stage.fuse]\nthinning = 1\n")
    (tmp_path / "flat.toml").write_text("[stages]\nfuse = 1\n")
    monkeypatch.setattr(
        settings, "presets", lambda: {p.stem: p for p in sorted(tmp_path.iterdir())}
    )
    with pytest.raises(SettingsError, match=r"Unknown table \[stage\]"):
        load_preset("odd")
    with pytest.raises(SettingsError, match="one table per stage"):
        load_preset("flat")


def test_every_preset_fits_the_pipeline():
    from stages.main import PIPELINE
    from workbench.pipeline.planner import checked_options

    for name in presets():
        assert len(checked_options(PIPELINE, load_preset(name))) == len(PIPELINE)


def test_a_suggestion_is_made_where_one_is_near():
    assert suggestion("regsiter", ["register", "fuse"]) == "did you mean 'register'?"
    assert suggestion("xyz", ["register", "fuse"]) is None
