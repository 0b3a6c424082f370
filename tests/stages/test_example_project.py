"""The project that travels with the source runs as it stands."""

import shutil
from pathlib import Path

from tests.stages.conftest import metrics_of, workbench

EXAMPLE = Path(__file__).resolve().parents[2] / "projects" / "small-statue"


def test_the_example_becomes_a_closed_model_without_a_truth_to_look_at(tmp_path):
    project = tmp_path / "example"
    shutil.copytree(
        EXAMPLE, project, ignore=shutil.ignore_patterns("work", "exports", "report", "truth")
    )
    plan = {stage["name"]: stage for stage in workbench("plan", project)["stages"]}
    for name in ("develop", "mask", "densify", "orient", "color", "texture"):
        assert plan.pop(name)["action"] == "left out"
    assert {stage["action"] for stage in plan.values()} == {"run"}
    assert "truth" not in plan["verify"]["reason"]
    workbench("run", project, "--to", "export")
    assert metrics_of(project, "register")["scans_placed"] == 8
    assert metrics_of(project, "register")["given_poses_kept"] is False
    assert metrics_of(project, "infill")["watertight"] is True
    assert metrics_of(project, "infill")["measured_area"] > 0.5
