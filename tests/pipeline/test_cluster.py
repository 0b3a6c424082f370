"""A Dask scheduler and workers, each a process of its own, that die at work."""

from __future__ import annotations

import io
import pickle

import pytest
from fake_pipeline import die_at_first, fake_project, matrix_product
from test_tasks import matrices, of, products

from workbench.errors import WorkbenchError
from workbench.pipeline import cluster
from workbench.pipeline.progress import Progress


@pytest.fixture(autouse=True)
def patient(monkeypatch):
    """A loaded machine may take its time to start workers."""
    monkeypatch.setattr(cluster, "_ANSWER_SECONDS", 60.0)


def test_two_workers_give_the_bytes_of_none_and_the_dashboard_is_told(scheduler, tmp_path):
    address, add_worker = scheduler
    for _ in range(2):
        add_worker()
    here, far = fake_project(tmp_path / "here"), fake_project(tmp_path / "far")
    expected = of(here).map_items("items", matrix_product, matrices(6))
    said = io.StringIO()
    tasks = of(far, cluster=address, progress=Progress(said))
    assert tasks.map_items("items", matrix_product, matrices(6)) == expected
    assert products(far) == products(here)
    assert "  dashboard: http://" in said.getvalue()


def dying(project, tmp_path, deaths: int) -> dict[str, dict]:
    log = tmp_path / f"{deaths}.log"
    return {"s0": {"name": "s0", "log": str(log), "deaths": deaths}}


def test_an_item_whose_worker_is_killed_is_done_by_another(scheduler, tmp_path):
    address, add_worker = scheduler
    for _ in range(2):
        add_worker()
    project = fake_project(tmp_path)
    tasks = of(project, cluster=address)
    summaries = tasks.map_items("items", die_at_first, dying(project, tmp_path, 1))
    assert summaries == {"s0": {"begun": 2}}
    assert project.store.load("oriented_scans", "s0")["n"].tolist() == [0]


def test_an_item_that_takes_three_workers_along_is_named_with_its_memory(scheduler, tmp_path):
    address, add_worker = scheduler
    for _ in range(4):
        add_worker()
    project = fake_project(tmp_path)
    tasks = of(project, cluster=address, item_memory_bytes=3 * 2**30)
    with pytest.raises(WorkbenchError, match="workers died while at work on s0") as caught:
        tasks.map_items("items", die_at_first, dying(project, tmp_path, 9))
    assert len((tmp_path / "9.log").read_text().split()) == 3
    assert caught.value.expected == "about 3.0 GiB of memory for a worker, as announced"
    assert "memory" in caught.value.fix
    # The others go on: the cluster is as good as before.
    assert tasks.map_items("items", matrix_product, matrices(1)) == {"m0": {"pid": 0}}


def test_what_is_sent_for_an_item_is_small(tmp_path, monkeypatch):
    sent = {}

    def measured(client, run, items, memory_bytes=0):
        for name, payload in items.items():
            sent[name] = len(pickle.dumps((run, name, payload)))
            yield name, run(name, payload)

    monkeypatch.setattr(cluster, "results_of", measured)
    monkeypatch.setattr(cluster, "the_cluster_at", lambda *_: io.StringIO())
    project = fake_project(tmp_path)
    of(project, cluster="tcp://x:1").map_items("items", matrix_product, matrices(3))
    assert sorted(sent) == ["m0", "m1", "m2"]
    assert max(sent.values()) < 1000
