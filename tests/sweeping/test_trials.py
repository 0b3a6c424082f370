"""What a sweep tries: knobs one at a time, given ones in all combinations, mistakes told."""

from __future__ import annotations

import pytest

from stages.main import PIPELINE
from workbench.cli.sweep_commands import seconds_of
from workbench.errors import InputError, SettingsError
from workbench.pipeline.knobs import Knob
from workbench.sweeping.trials import chosen_stages, parse_knobs, trials_of

STAGES = {stage.name: stage for stage in PIPELINE}
MEASURES = {name for stage in PIPELINE for name in stage.errors}


def test_every_stage_with_knobs_has_a_measure_of_its_error():
    swept = [stage for stage in PIPELINE if stage.knobs]
    assert {"register", "fuse", "infill", "orient", "color", "texture"} <= {s.name for s in swept}
    for stage in swept:
        for knob in stage.knobs:
            assert (knob.measure or stage.name) in MEASURES, (stage.name, knob.option)


def test_declared_knobs_are_turned_one_at_a_time_from_where_they_stand():
    trials = trials_of(STAGES["fuse"], {"fuse": {"half_window": 3}}, {})
    assert trials[0].default
    assert trials[0].knobs["half_window"] == 3
    assert not any(trial.default for trial in trials[1:])
    for trial in trials[1:]:
        turned = [k for k, v in trial.knobs.items() if v != trials[0].knobs[k]]
        assert len(turned) == 1
        assert getattr(trial.options, turned[0]) == trial.knobs[turned[0]]
    shown = [tuple(trial.knobs.items()) for trial in trials]
    assert len(set(shown)) == len(shown)
    quick = trials_of(STAGES["fuse"], {}, {}, quick=True)
    assert 1 < len(quick) < len(trials)


def test_given_knobs_are_tried_in_all_combinations():
    given = parse_knobs(["infill.depth=6,7", "infill.refine_rounds=0,1,2"], PIPELINE)
    assert given == {"infill": {"depth": (6, 7), "refine_rounds": (0, 1, 2)}}
    trials = trials_of(STAGES["infill"], {}, given)
    # The setting in force, too.
    assert len(trials) == 7
    assert {(t.options.depth, t.options.refine_rounds) for t in trials[1:]} == {
        (depth, rounds) for depth in (6, 7) for rounds in (0, 1, 2)
    }


def test_levels_of_an_export_are_swept_alone():
    trials = trials_of(STAGES["export"], {"export": {"obj": True}}, {})
    for trial in trials:
        assert not trial.options.obj
        assert (trial.options.voxels == "none") == (trial.measure == "surfels")


@pytest.mark.parametrize(
    "text", ["infill", "infill.depth", "infill.depth=", "depth=6,7", "nonsense.depth=6"]
)
def test_knobs_that_are_not_understood_are_told(text: str):
    with pytest.raises((SettingsError, InputError)):
        parse_knobs([text], PIPELINE)


def test_options_that_do_not_exist_or_may_not_be_so_are_told():
    for text in ("infill.dept=6", "infill.depth=99"):
        with pytest.raises(SettingsError):
            trials_of(STAGES["infill"], {}, parse_knobs([text], PIPELINE))
    with pytest.raises(InputError, match="no knob"):
        chosen_stages(PIPELINE, ["ingest"], {})


def test_a_knob_that_a_stage_does_not_have_cannot_be_declared():
    with pytest.raises(ValueError, match="infill"):
        Knob("depth", (6, 99)).check("infill", STAGES["infill"].options)
    with pytest.raises(ValueError, match="quick"):
        Knob("depth", (6, 7), quick=(8,)).check("infill", STAGES["infill"].options)


@pytest.mark.parametrize(
    ("text", "seconds"), [("90s", 90), ("10min", 600), ("1.5h", 5400), ("7", 7)]
)
def test_budgets_of_time(text: str, seconds: float):
    assert seconds_of(text) == seconds
    with pytest.raises(SettingsError):
        seconds_of("-" + text)
