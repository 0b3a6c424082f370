"""All stages of a small project on a scheduler with two workers, each a process of its own."""

import hashlib
import shutil
from pathlib import Path

import pytest

from stages.main import PIPELINE
from tests.benchmarks.bench_cluster import bytes_sent, running_cluster
from tests.faults.scene import make_scene
from workbench.pipeline.progress import Progress
from workbench.pipeline.runner import RunRequest, run_pipeline
from workbench.project.project import Project

pytestmark = pytest.mark.slow
#: ``verify`` writes dates and times.
LAST = "export"


def run(project: Path, **where) -> dict[str, str]:
    request = RunRequest(last=LAST, workers=1, **where)
    run_pipeline(PIPELINE, Project(project), request, Progress(quiet=True))
    store = Project(project).store
    return {
        str(path.relative_to(project)): hashlib.sha256(path.read_bytes()).hexdigest()
        for stage in PIPELINE
        for name in stage.writes
        for path in store.paths(name)
    }


def test_a_cluster_gives_the_bytes_of_one_machine(tmp_path):
    here = make_scene(tmp_path)
    far = tmp_path / "far"
    shutil.copytree(here, far)
    expected = run(here)
    with running_cluster(tmp_path, 2) as address:
        assert run(far, cluster=address) == expected
    assert len(expected) > 60


def test_what_is_sent_for_an_item_is_small_in_every_stage(tmp_path):
    sent = bytes_sent(tmp_path)
    assert set(sent) == {
        "read_scan_file", "look_at", "develop_photo", "mask_scan", "mask_photo", "orient_scan",
        "solve_block", "cut_block", "see_photo", "light_photo", "see_cloud", "free_photo",
        "label_photo",
    }  # fmt: skip
    assert max(sent.values()) < 4096
