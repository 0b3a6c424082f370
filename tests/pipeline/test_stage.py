from __future__ import annotations

from dataclasses import replace

import pytest
from fake_pipeline import PIPELINE, with_stage

from stages.main import PIPELINE as REAL
from workbench.errors import InputError
from workbench.pipeline.planner import in_working_order
from workbench.pipeline.stage import Products, StageResult
from workbench.project.artefacts import ARTEFACTS
from workbench.project.project import Scene

TRUTH = sorted(name for name, artefact in ARTEFACTS.items() if artefact.truth)


@pytest.mark.parametrize("name", TRUTH)
def test_a_stage_that_names_the_truth_cannot_be_built(name):
    fuse = PIPELINE[2]
    with pytest.raises(ValueError, match="truth"):
        replace(fuse, reads=(*fuse.reads, name))
    with pytest.raises(ValueError, match="truth"):
        replace(fuse, writes=(*fuse.writes, name))
    with pytest.raises(ValueError, match="truth"):
        replace(fuse, writes=(*fuse.writes, name), reads_truth=True)


@pytest.mark.parametrize(
    "change",
    [
        {"reads": ("nonsense",)},
        {"writes": ("nonsense",)},
        {"writes": ("scan_files",)},
        {"writes": ("records",)},
        {"writes": ("scan_inventory",)},
    ],
)
def test_what_a_stage_declares_must_make_sense(change):
    with pytest.raises(ValueError, match=r"stage fuse"):
        replace(PIPELINE[2], **change)


def test_products_are_those_declared(project):
    products = Products(project, ("scan_files", "scan_inventory"), ("scan_poses",))
    products.save("scan_poses", {"a": 1})
    assert products.load("scan_poses") == {"a": 1}
    assert products.load_if_there("scan_inventory") is None
    assert len(products.input_paths("scan_files")) == 2
    for refused in (
        lambda: products.load("samples"),
        lambda: products.load_if_there("truth_poses"),
        lambda: products.items("oriented_scans"),
        lambda: products.content_hash("oriented_scans", "s0"),
        lambda: products.input_paths("photo_files"),
        lambda: products.save("scan_inventory", {}),
        lambda: products.writing("samples"),
        lambda: products.remove_items_except("oriented_scans", set()),
    ):
        with pytest.raises(PermissionError, match="does not declare"):
            refused()


def test_what_was_left_out_is_not_there_whatever_lies_in_its_place(project):
    project.store.save("scan_poses", {"old": True})
    products = Products(project, ("scan_poses",), (), frozenset({"scan_poses"}))
    assert products.load_if_there("scan_poses") is None
    with pytest.raises(InputError, match="left out"):
        products.load("scan_poses")


def test_a_product_this_run_did_not_make_does_not_stay(project, run):
    run(project)
    assert project.store.exists("surface_obj")
    outcomes = run(project, overrides={"export": {"obj": False}})
    assert outcomes["export"]["action"] == "run"
    assert not project.store.exists("surface_obj")
    assert project.store.exists("surface_ply")
    made = {entry["artefact"] for entry in project.store.load("records", "export")["outputs"]}
    assert made == {"surface_ply"}


def test_a_stage_cannot_read_what_it_did_not_declare(project, run):
    def curious(job):
        job.products.load("scan_poses")
        return StageResult()

    with pytest.raises(PermissionError):
        run(project, with_stage("export", run=curious))


@pytest.mark.parametrize("scans", [3, 0], ids=["scans", "photographs alone"])
@pytest.mark.parametrize("pipeline", [PIPELINE, REAL], ids=["fake", "real"])
def test_every_artefact_has_one_maker_before_its_readers(pipeline, scans):
    scene = Scene(scans, True, 5, False, False, False, False, 1000)
    needs = {stage.name: stage.needed(scene, stage.options()) for stage in pipeline}
    # Commands of their own make what a report tells of the methods and the page.
    made = {"fault_table", "page_measures", "stability_table", "sweep_points"}
    # What is left out keeps nobody waiting.
    made |= {n for stage in pipeline if not needs[stage.name].needed for n in stage.writes}
    for stage in in_working_order(pipeline, needs):
        if not needs[stage.name].needed:
            continue
        assert not made & set(stage.writes), stage.name
        brought = {
            name
            for name in stage.reads
            if ARTEFACTS[name].format == "input" or ARTEFACTS[name].truth or name == "records"
        }
        assert set(stage.reads) - brought - needs[stage.name].without <= made, stage.name
        made |= set(stage.writes)
    assert [stage.name for stage in pipeline if stage.reads_truth] == ["verify"]
