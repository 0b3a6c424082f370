from __future__ import annotations

import errno
import io
import json
from pathlib import Path

import psutil
import pytest
from fake_pipeline import PIPELINE, fake_project, fuse, with_stage

from workbench.errors import InputError, WorkbenchError
from workbench.pipeline import runner
from workbench.pipeline.freshness import state_of
from workbench.pipeline.progress import Progress
from workbench.pipeline.records import RecordFolder
from workbench.pipeline.stage import LIBRARY_BYTES, Estimate, StageResult
from workbench.project.hashing import FileHashes
from workbench.project.project import Project
from workbench.project.settings import options_for


def record_of(project: Project, stage: str) -> dict:
    return project.store.load("records", stage)


def state(project: Project, name: str):
    (stage,) = (s for s in PIPELINE if s.name == name)
    options = options_for(name, stage.options, project.settings())
    return state_of(Project(project.root), stage, options, frozenset())


def test_the_record_holds_all_that_is_known_of_the_run(project, run):
    outcome = run(project, overrides={"ingest": {"scan_unit": "mm", "threads": 3}})["ingest"]
    record = record_of(project, "ingest")
    for key in ("name", "action", "seconds", "peak_rss_bytes", "metrics", "reason", "warnings"):
        assert record[key] == outcome[key]
    assert record["state"] == "done"
    assert record["options"] == {"scan_unit": "mm", "first_line_only": True, "threads": 3}
    assert set(record["libraries"]) == {"scan-workbench", "numpy"}
    assert record["metrics"] == [{"name": "scans", "value": 2, "unit": "", "description": "Scans."}]
    assert record["warnings"] == ["all is well"]
    assert record["peak_rss_bytes"] > 10_000_000
    assert record["cpu_seconds"] >= 0.0
    assert record["seconds"] >= 0.0
    assert record["started"] <= record["ended"]
    assert record["started"].endswith("+00:00")
    assert record["host"]["memory_bytes"] > 0
    fresh = FileHashes(Path("nowhere"), project.root)
    assert [entry["path"] for entry in record["inputs"]] == ["../scans/s0.xyz", "../scans/s1.xyz"]
    for entry in record["inputs"] + record["outputs"]:
        path = project.root / entry["path"]
        assert entry["hash"] == fresh.of_file(path)
        assert entry["bytes"] == path.stat().st_size
    assert [entry["artefact"] for entry in record["outputs"]] == ["scan_inventory"]


def test_settings_are_taken_in_order_and_kept_with_the_result(project, run, monkeypatch):
    toml = project.root / "project.toml"
    toml.write_text(toml.read_text() + "[stages.fuse]\nthinning = 2.0\nwindow.rows = 4\n")
    preset = {"fuse": {"thinning": 1.0, "window": {"rows": 5, "cols": 6}, "depth": 8}}
    monkeypatch.setattr("workbench.project.project.load_preset", lambda name: preset)
    run(project, overrides={"fuse": {"depth": 9}})
    assert record_of(project, "fuse")["options"] == {
        "thinning": 2.0,
        "depth": 9,
        "window": {"rows": 4, "cols": 6},
    }
    # The result stays what it was made with, whatever the project says later.
    toml.write_text(toml.read_text().replace("2.0", "3.0"))
    assert record_of(project, "fuse")["options"]["thinning"] == 2.0


def test_only_the_asked_for_stages_run(project, done):
    assert done(project, last="fuse") == ["ingest", "fuse"]
    assert done(project, target="export") == ["export"]
    assert done(project, only="fuse") == []
    assert done(project, only="fuse", force=True) == ["fuse"]
    assert done(project, first="ingest", last="fuse", force=True) == ["ingest", "fuse"]
    assert done(project, target="export", force=True) == ["export"]
    assert done(project) == ["verify"]
    assert done(project, force=True) == ["ingest", "fuse", "export", "verify"]
    assert record_of(project, "fuse")["reason"] == "forced"


def test_force_does_the_items_again(project, done, monkeypatch, tmp_path):
    log = tmp_path / "log"
    monkeypatch.setenv("FAKE_ITEM_LOG", str(log))
    done(project)
    done(project, overrides={"fuse": {"window": {"rows": 4}}})
    done(project, only="fuse", force=True, overrides={"fuse": {"window": {"rows": 4}}})
    assert log.read_text().split() == ["s0.xyz", "s1.xyz"] * 3


def test_only_without_what_it_needs_is_refused_before_anything_happens(project, run):
    with pytest.raises(InputError, match="fuse needs what ingest makes") as caught:
        run(project, only="fuse")
    assert "workbench fuse" in caught.value.fix
    assert not (project.root / "work" / "fuse").exists()
    run(project, last="ingest")
    project.store.path("scan_inventory").unlink()
    with pytest.raises(InputError, match="fuse needs what ingest makes"):
        run(project, first="fuse")
    assert not (project.root / "work" / "fuse").exists()


def test_old_products_outside_the_run_are_used_with_a_warning(project, run):
    run(project)
    stream = io.StringIO()
    run(
        project,
        first="fuse",
        overrides={"ingest": {"scan_unit": "mm"}},
        progress=Progress(stream),
    )
    assert "warning: ingest is not part of this run though options changed" in stream.getvalue()


def test_an_error_in_the_middle_leaves_the_old_product_whole(project, run, done):
    run(project)
    before = project.store.path("surface_ply").read_bytes()

    def half(job):
        with job.products.writing("surface_ply") as path:
            path.write_bytes(b"half")
            raise InputError("The disk is full of rats", file="rat.ply")

    broken = with_stage("export", run=half, version=2)
    with pytest.raises(InputError) as caught:
        run(project, broken)
    assert caught.value.stage == "export"
    assert project.store.path("surface_ply").read_bytes() == before
    assert not list(project.root.glob("exports/.*"))
    found = state(project, "export")
    assert (found.state, found.reason) == ("failed", "The disk is full of rats")
    assert record_of(project, "export")["state"] == "failed"
    assert "rat.ply" in record_of(project, "export")["reason"]
    assert done(project) == ["export", "verify"]
    assert state(project, "export").state == "fresh"


def test_a_fault_of_ours_is_a_failure_too_and_names_its_kind(project, run, plan):
    def faulty(job):
        raise ZeroDivisionError("by nothing")

    with pytest.raises(ZeroDivisionError):
        run(project, with_stage("export", run=faulty))
    found = state(project, "export")
    assert (found.state, found.reason) == ("failed", "ZeroDivisionError: by nothing")
    assert plan(project)["export"] == ("run", "failed: ZeroDivisionError: by nothing")


def test_what_was_finished_before_the_error_stays(project, run, done):
    def faulty(job):
        raise InputError("no")

    with pytest.raises(InputError):
        run(project, with_stage("fuse", run=faulty))
    assert done(project) == ["fuse", "export", "verify"]


def test_an_input_that_changes_during_the_run_is_found_to_have_changed(project, run, plan):
    def meddled(job):
        result = fuse(job)
        project.store.save("scan_inventory", {"unit": "m", "lines": {}})
        return result

    run(project, with_stage("fuse", run=meddled), last="fuse")
    assert "scans.json changed" in plan(project, with_stage("fuse", run=meddled))["fuse"][1]


@pytest.mark.parametrize(
    ("estimate", "what"),
    [(Estimate(2**60, 0), "memory"), (Estimate(0, 2**60), "disk space")],
)
def test_too_little_room_is_told_before_any_work(project, run, estimate, what):
    pipeline = with_stage("export", estimate=lambda scene, options: estimate)
    with pytest.raises(InputError, match=f"Not enough {what} for export") as caught:
        run(project, pipeline)
    assert caught.value.exit_code == 2
    assert "GiB" in caught.value.expected
    assert not (project.root / "work" / "ingest").exists()
    # What is not to run needs no room.
    run(project, pipeline, last="fuse")


def test_room_is_measured_not_guessed(project, run, monkeypatch):
    memory = psutil.virtual_memory()
    monkeypatch.setattr(runner.psutil, "virtual_memory", lambda: memory._replace(available=10**6))
    pipeline = with_stage("fuse", estimate=lambda scene, options: Estimate(2 * 10**6, 0))
    with pytest.raises(InputError, match="memory"):
        run(project, pipeline)
    run(project, with_stage("fuse", estimate=lambda scene, options: Estimate(10**5, 0)))
    with pytest.raises(InputError, match="memory"):
        run(project, pipeline, only="fuse", force=True)


def test_as_many_are_at_work_as_memory_holds(project, run, monkeypatch):
    memory = psutil.virtual_memory()
    monkeypatch.setattr(runner.psutil, "virtual_memory", lambda: memory._replace(available=2**33))
    monkeypatch.setattr(runner, "_cores", lambda: 8)
    at_work = []

    def watched(job):
        at_work.append(job.tasks.workers)
        return StageResult()

    def told(workers, item_bytes):
        # 4 of 8 GiB for the first, 2 for each further one, libraries included.
        pipeline = with_stage(
            "export", run=watched, estimate=lambda *_: Estimate(2**32, 0, item_bytes=item_bytes)
        )
        stream = io.StringIO()
        request = {"force": True, "workers": workers, "only": "export"}
        run(project, pipeline, progress=Progress(stream), **request)
        return stream.getvalue()

    run(project)
    one = 2**31 - LIBRARY_BYTES
    assert "export: 3 at work and not 8, for each takes about 2.0 GiB and 8.0" in told(None, one)
    assert "at work" not in told(None, 0)
    with pytest.raises(InputError, match="Not enough memory for 4 workers of export") as caught:
        told(4, one)
    assert "--workers 3" in caught.value.fix
    assert "at work" not in told(3, one)
    assert at_work == [3, 8, 3]


def test_mistakes_in_any_stage_are_found_before_the_first_runs(project, run):
    with pytest.raises(WorkbenchError):
        run(project, overrides={"export": {"ply": 3}})
    assert not (project.root / "work" / "ingest").exists()


def test_a_moved_project_stays_fresh(tmp_path, run, done):
    project = fake_project(tmp_path / "here 'n' \"there\" – Größe")
    run(project)
    record = record_of(project, "fuse")
    (tmp_path / "here 'n' \"there\" – Größe").rename(tmp_path / "elsewhere")
    moved = Project(tmp_path / "elsewhere" / "project")
    assert done(moved) == []
    assert record_of(moved, "fuse") == record


def test_a_copied_project_stays_fresh_without_its_memory_of_hashes(tmp_path, run, done):
    import shutil

    project = fake_project(tmp_path / "a")
    run(project)
    shutil.copytree(tmp_path / "a", tmp_path / "b")
    shutil.rmtree(tmp_path / "a")
    copied = Project(tmp_path / "b" / "project")
    assert done(copied) == []
    (copied.root / "work" / "hashes.json").write_text("{broken")
    assert done(copied) == []


def test_results_do_not_depend_on_where_or_when(tmp_path, run):
    trees = []
    for name in ("a", "b c"):
        project = fake_project(tmp_path / name, scans=3)
        run(project)
        trees.append(
            {
                path.relative_to(project.root): path.read_bytes()
                for path in sorted(project.root.rglob("*"))
                if path.is_file() and path.name not in ("record.json", "hashes.json", ".lock")
            }
        )
    assert trees[0] == trees[1]


def test_a_damaged_record_counts_as_none_and_is_told(project, run, done):
    run(project)
    path = project.store.path("records", "export")
    whole = path.read_text()
    wrong_number = whole.replace('"peak_rss_bytes": ', '"peak_rss_bytes": 1')
    assert wrong_number != whole
    for text in (whole[:40], "", json.dumps([1]), wrong_number):
        path.write_text(text)
        assert state(project, "export").state == "stale"
        assert state(project, "export").reason == "its record is damaged"
        assert RecordFolder(project, "export").read() is None
    assert done(project) == ["export", "verify"]


def test_records_of_other_versions_are_read_and_never_fresh(project, run, done):
    run(project)
    path = project.store.path("records", "export")
    record = json.loads(path.read_text())
    del record["seal"], record["fingerprint"]["schemas"]
    path.write_text(json.dumps(record))
    assert state(project, "export").reason == "code changed: another form of what is stored"
    path.write_text(json.dumps({"state": "failed", "reason": ""}))
    assert state(project, "export").state == "failed"


def test_what_a_killed_run_left_half_written_goes_when_its_stage_runs(project, run):
    run(project)
    exports = project.store.path("surface_ply").parent
    left = [
        exports / ".surface.ply.0a1b2c3d.partial",
        exports / "..surface.ply.0a1b2c3d.partial.4e5f6071.partial",
        project.root / "work/fuse/scans/.s0.npz.0a1b2c3d.partial",
        project.root / "work/fuse/items/normals_of/.s0.json.0a1b2c3d.partial",
        project.root / "work/fuse/.record.json.0a1b2c3d.partial",
        project.root / "work/.hashes.json.0a1b2c3d.partial",
    ]
    for path in left:
        path.write_bytes(b"half")
    sorting = project.root / "work/fuse/.samples.npz.0a1b2c3d.partial.x_y"
    sorting.mkdir()
    (sorting / "sorted").write_bytes(b"half")
    kept = [exports / ".surface.ply.swp", exports / "notes.partial"]
    for path in kept:
        path.write_bytes(b"of the user")
    run(project, force=True)
    assert not [path for path in (*left, sorting) if path.exists()]
    assert all(path.exists() for path in kept)


def test_what_only_helped_a_stage_goes_once_its_record_is_written(project, run, done, monkeypatch):
    def helped(job):
        fuse(job)
        return StageResult(passing=("oriented_scans",))

    def killed(*_):
        raise KeyboardInterrupt

    pipeline = with_stage("fuse", run=helped)
    run(project, last="ingest")
    with monkeypatch.context() as broken:
        broken.setattr(RecordFolder, "write", killed)
        with pytest.raises(KeyboardInterrupt):
            run(project, pipeline, only="fuse")
    assert project.store.items("oriented_scans") == ("s0", "s1")
    run(project, pipeline, last="fuse")
    assert project.store.items("oriented_scans") == ()
    assert set(record_of(project, "fuse")["output_hashes"]) == {"samples"}
    assert done(project, pipeline, last="fuse") == []


def test_a_disk_that_is_full_is_told_even_where_no_record_can_be_written(project, run, monkeypatch):
    def full(*_, **__):
        raise OSError(errno.ENOSPC, "No space left on device")

    def refuse(job):
        raise InputError("The scan is bad")

    monkeypatch.setattr(RecordFolder, "write", full)
    with pytest.raises(InputError, match="The scan is bad"):
        run(project, with_stage("ingest", run=refuse))
    monkeypatch.setattr(Path, "write_text", full)
    with pytest.raises(InputError, match="cannot be written") as caught:
        run(project)
    assert caught.value.found == "No space left on device"
    assert "room" in caught.value.fix
    assert caught.value.file == str(project.root / "work")


def test_a_stage_that_says_nothing_still_leaves_a_record(project, run):
    def idle(job):
        return StageResult()

    run(project, with_stage("export", run=idle, writes=()), last="export")
    record = record_of(project, "export")
    assert record["outputs"] == []
    assert record["peak_rss_bytes"] > 0
