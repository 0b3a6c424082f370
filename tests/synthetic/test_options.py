from __future__ import annotations

import json

import pytest
from pydantic import BaseModel, ValidationError

from workbench.synthetic import (
    CoarsePoseOptions,
    ScannerOptions,
    SimulationOptions,
    StationOptions,
)


@pytest.mark.parametrize(
    "wrong",
    [
        {"scene": "castle"},
        {"noise": 1},
        {"scanner": {"depth_sigma": 0.1}},
        {"scanner": {"grazing_dropout": 1.5}},
        {"scanner": {"depth_sigma_m": -1e-3}},
        {"scans": 0},
        {"scanner": {"mixed_step_min_m": 0.5}},
        {"scanner": {"max_range_m": 0.1}},
        {"coarse_poses": {"pivot": "moon"}},
    ],
)
def test_unknown_and_out_of_bounds_options_are_refused(wrong: dict[str, object]) -> None:
    with pytest.raises(ValidationError):
        SimulationOptions.model_validate(wrong)


def test_what_is_not_given_comes_from_the_scene_and_what_is_given_stays() -> None:
    building = SimulationOptions.model_validate(
        {"scene": "building", "scanner": {"depth_sigma_m": 0.005}}
    )
    assert building.scanner.depth_sigma_m == 0.005
    assert building.scanner.projection == "spherical"
    assert building.scanner.max_range_m == 60.0
    assert building.world_offset_m == (5e5, 5.2e6, 120.0)
    assert building.coarse_poses.pivot == "scanner"
    assert SimulationOptions().world_offset_m == (0.0, 0.0, 0.0)


def test_a_saved_copy_gives_the_same_options() -> None:
    options = SimulationOptions.model_validate({"scene": "thin-sheet", "size": "medium", "seed": 5})
    saved = json.loads(json.dumps(options.model_dump(mode="json")))
    assert SimulationOptions.model_validate(saved) == options


def test_the_statue_defaults_are_those_of_the_nested_models() -> None:
    options = SimulationOptions()
    assert options.scanner == ScannerOptions()
    assert options.stations == StationOptions()
    assert options.coarse_poses == CoarsePoseOptions()


@pytest.mark.parametrize(
    "model", [SimulationOptions, ScannerOptions, StationOptions, CoarsePoseOptions]
)
def test_every_option_has_one_help_sentence(model: type[BaseModel]) -> None:
    for name, field in model.model_fields.items():
        assert field.description, name
        assert field.description.endswith("."), name


@pytest.mark.parametrize(
    ("size", "spacing_m"), [("small", 4.5e-3), ("medium", 2e-3), ("large", 1e-3)]
)
def test_sample_spacing_on_the_statue(size: str, spacing_m: float) -> None:
    from workbench.synthetic.writing import nominal_spacing_m

    options = SimulationOptions.model_validate({"size": size})
    assert nominal_spacing_m(options) == pytest.approx(spacing_m, rel=0.12)
