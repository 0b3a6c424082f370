from __future__ import annotations

import os

import pytest
from fake_pipeline import PIPELINE, fake_project, with_stage

from workbench.errors import InputError, SettingsError
from workbench.pipeline import freshness
from workbench.pipeline.planner import in_working_order, make_plan, needed_for, selected
from workbench.pipeline.stage import Need, Stage, StageResult
from workbench.project import artefacts
from workbench.project.project import Project
from workbench.project.settings import StageOptions

ALL = ["ingest", "fuse", "export", "verify"]


def test_a_new_project_runs_what_it_needs_and_says_why(project, plan):
    assert plan(project) == {
        "ingest": ("run", "always needed"),
        "register": ("left out", "no poses"),
        "fuse": ("run", "always needed"),
        "export": ("run", "always needed"),
        "verify": ("run", "always needed"),
    }


def test_what_is_done_is_fresh(project, plan, done):
    assert done(project) == ALL
    assert {action for action, _ in plan(project).values()} == {"fresh", "left out"}
    assert done(project) == []


def test_a_changed_option_reruns_its_stage_and_says_from_what_to_what(project, plan, done):
    done(project)
    told = plan(project, overrides={"fuse": {"thinning": 1.0, "window": {"rows": 3}}})
    assert told["ingest"][0] == "fresh"
    assert told["fuse"] == ("stale", "options changed: thinning from 0.5 to 1.0")
    assert told["export"] == ("stale", "waits for fuse, which will run first")
    told = plan(project, overrides={"fuse": {"window": {"rows": 5}}})
    assert told["fuse"][0] == "stale"
    assert "window" in told["fuse"][1]


def test_an_option_that_cannot_change_the_result_leaves_it_fresh(project, plan, done):
    done(project)
    assert plan(project, overrides={"ingest": {"threads": 4}})["ingest"][0] == "fresh"


def test_input_content_decides_and_the_file_is_named(project, plan, done):
    done(project)
    scan = project.root.parent / "scans" / "s1.xyz"
    content = scan.read_text()
    os.utime(scan, (1, 1))
    assert plan(project)["ingest"][0] == "fresh"
    scan.write_text("9" + content[1:])
    os.utime(scan, (1, 1))
    assert plan(project)["ingest"] == (
        "stale",
        "input changed: the range scans the user brought (s1.xyz changed)",
    )
    scan.write_text(content)
    assert plan(project)["ingest"][0] == "fresh"
    (scan.parent / "s2.xyz").write_text("2 0 0\n")
    assert plan(project)["ingest"][1].endswith("(s2.xyz is new)")
    (scan.parent / "s2.xyz").rename(scan.parent / "s0.pts")
    (scan.parent / "s0.xyz").unlink()
    assert "s0." in plan(project)["ingest"][1]


@pytest.mark.parametrize("name", ["scan_inventory", "samples", "surface_obj"])
def test_a_deleted_output_is_missed_and_made_again(project, plan, done, name):
    done(project)
    path = project.store.path(name)
    before = path.read_bytes()
    path.unlink()
    (stage,) = (s.name for s in PIPELINE if name in s.writes)
    action, reason = plan(project)[stage]
    assert action == "stale"
    assert reason.startswith("missing output: ")
    assert stage in done(project)
    assert path.read_bytes() == before


@pytest.mark.parametrize(("name", "item"), [("samples", None), ("oriented_scans", "s1")])
def test_a_flipped_bit_in_a_product_is_found_and_mended(project, plan, done, name, item):
    done(project)
    path = project.store.path(name, item)
    good = path.read_bytes()
    status = path.stat()
    bad = bytearray(good)
    bad[len(bad) // 2] ^= 1
    path.write_bytes(bad)
    os.utime(path, ns=(status.st_atime_ns, status.st_mtime_ns))
    action, reason = plan(project)["fuse"]
    assert action == "stale"
    assert reason.startswith("output changed since: ")
    assert "fuse" in done(project)
    assert path.read_bytes() == good


def test_another_version_of_a_library_or_the_code_makes_stale(project, plan, done, monkeypatch):
    done(project)
    pipeline = with_stage("fuse", version=2)
    assert plan(project, pipeline)["fuse"] == ("stale", "code changed: version 1 to 2")
    assert plan(project, pipeline)["ingest"][0] == "fresh"
    real = freshness.library_versions
    monkeypatch.setattr(
        freshness,
        "library_versions",
        lambda names: {k: "99.0" if k == "numpy" else v for k, v in real(names).items()},
    )
    action, reason = plan(project)["ingest"]
    assert action == "stale"
    assert reason.startswith("library changed: numpy from ")
    assert reason.endswith("to 99.0")
    assert plan(project)["export"][1] == "waits for fuse, which will run first"


def test_another_form_of_a_product_makes_its_maker_and_readers_stale(
    project, plan, done, monkeypatch
):
    done(project)
    changed = artefacts.Artefact("samples", "work/fuse/samples.npz", "arrays", "samples", schema=2)
    monkeypatch.setitem(artefacts.ARTEFACTS, "samples", changed)
    told = plan(project)
    assert told["ingest"][0] == "fresh"
    assert told["fuse"][1] == told["export"][1] == "code changed: another form of what is stored"


def test_the_same_bytes_again_leave_what_follows_fresh(project, plan, run, done):
    done(project)
    scan = project.root.parent / "scans" / "s0.xyz"
    scan.write_text(scan.read_text() + "only the first line counts\n")
    assert plan(project)["fuse"] == ("stale", "waits for ingest, which will run first")
    outcomes = run(project)
    actions = {name: outcome["action"] for name, outcome in outcomes.items()}
    # The report shows when ingest ran, so it is written again.
    assert actions == {
        "ingest": "run",
        "register": "left out",
        "fuse": "fresh",
        "export": "fresh",
        "verify": "run",
    }
    assert outcomes["fuse"]["reason"].startswith("done ")
    assert outcomes["fuse"]["metrics"][0]["name"] == "total"


def test_a_stage_left_out_takes_its_old_products_with_it(tmp_path, plan, done):
    project = fake_project(tmp_path, poses=True)
    assert done(project) == ["ingest", "register", "fuse", "export", "verify"]
    assert bool(project.store.load("samples")["posed"]) is True
    (tmp_path / "scans" / "poses.conf").unlink()
    told = plan(project)
    assert told["register"] == ("left out", "no poses")
    assert "fuse" in done(project)
    assert project.store.exists("scan_poses")
    assert bool(project.store.load("samples")["posed"]) is False
    report = project.store.load("report_json")
    assert "register" not in report["stages"]
    assert report["left_out"] == {"register": "no poses"}
    action, reason = plan(project)["fuse"]
    assert action == "fresh", reason


def test_unknown_stages_and_options_are_refused_with_a_suggestion(project):
    for overrides, wrong, right in (
        ({"fusse": {"thinning": 1.0}}, "fusse", "fuse"),
        ({"fuse": {"thining": 1.0}}, "fuse.thining", "thinning"),
        ({"fuse": {"window": {"row": 1}}}, "fuse.window.row", "rows"),
    ):
        with pytest.raises(SettingsError) as caught:
            make_plan(PIPELINE, project, overrides)
        assert wrong in caught.value.message
        assert caught.value.fix == f"did you mean {right!r}?"
        assert caught.value.exit_code == 2


def test_a_stage_stands_behind_those_it_reads_in_this_scene():
    def stage(name, reads, writes):
        return Stage(
            name=name, version=1, summary="", options=StageOptions, reads=reads, writes=writes,
            needed=lambda scene, options: Need(True, ""), run=lambda job: StageResult(),
        )  # fmt: skip

    pipeline = (
        stage("fuse", ("photo_range_maps",), ("samples",)),
        stage("infill", ("samples",), ("surface",)),
        stage("orient", ("surface",), ("photo_poses",)),
        stage("densify", ("photo_poses",), ("photo_range_maps",)),
    )

    def order(**needs):
        told = {one.name: needs.get(one.name, Need(True, "")) for one in pipeline}
        return [one.name for one in in_working_order(pipeline, told)]

    no = Need(False, "not wanted")
    assert order(densify=no) == ["fuse", "infill", "orient", "densify"]
    alone = Need(True, "", frozenset(("surface",)))
    assert order(orient=alone) == ["orient", "densify", "fuse", "infill"]
    with pytest.raises(ValueError, match="wait for each other"):
        order()


def test_stages_are_selected_by_name(project):
    made = make_plan(PIPELINE, Project(project.root))

    def names(**bounds):
        return [planned.stage.name for planned in selected(made, **bounds)]

    assert names() == ["ingest", "register", "fuse", "export", "verify"]
    assert names(first="fuse") == ["fuse", "export", "verify"]
    assert names(last="fuse") == ["ingest", "register", "fuse"]
    assert names(first="register", last="export") == ["register", "fuse", "export"]
    assert names(only="fuse") == ["fuse"]
    assert [p.stage.name for p in needed_for(made, "export")] == [
        *("ingest", "register", "fuse", "export")
    ]
    with pytest.raises(InputError, match="no stage 'exprot'") as caught:
        names(first="exprot")
    assert caught.value.fix == "did you mean 'export'?"
    with pytest.raises(InputError, match="comes after"):
        names(first="export", last="ingest")
    with pytest.raises(InputError, match="--only leaves nothing"):
        names(only="fuse", last="verify")
