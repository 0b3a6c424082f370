from __future__ import annotations

import io
import json
import os
import pickle
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from fake_pipeline import die, fake_project, matrix_product, normals_of, refuse
from threadpoolctl import threadpool_info, threadpool_limits

from workbench.errors import (
    InputError,
    MissingPartError,
    ProjectLockedError,
    SettingsError,
    WorkbenchError,
)
from workbench.pipeline import cluster, tasks
from workbench.pipeline.progress import Progress
from workbench.pipeline.records import RecordFolder
from workbench.pipeline.tasks import ItemProducts, Tasks
from workbench.pipeline.threads import one_blas_thread
from workbench.project.hashing import FileHashes
from workbench.project.project import Project
from workbench.project.store import ProductStore


def of(project: Project, **where) -> Tasks:
    return Tasks(
        root=project.root,
        stage="fuse",
        fingerprint="f",
        hashes=FileHashes(project.root / "work" / "hashes.json", project.root),
        writes=("oriented_scans",),
        **({"progress": Progress(io.StringIO())} | where),
    )


def products(project: Project) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in project.store.paths("oriented_scans")}


def matrices(count: int, **more) -> dict[str, dict]:
    # Backwards, so that an order by name or by time would be seen.
    return {f"m{seed}": {"seed": seed, **more} for seed in reversed(range(count))}


@pytest.fixture
def alone(tmp_path):
    """A project whose items one worker did."""
    project = fake_project(tmp_path / "alone")
    summaries = of(project, workers=1).map_items("items", matrix_product, matrices(5))
    return summaries, products(project)


@pytest.fixture
def at_once(monkeypatch):
    """No patience: whatever has not begun goes to a local cluster."""
    monkeypatch.setattr(tasks, "_CLUSTER_START_SECONDS", 0.0)


def test_workers_change_neither_bytes_nor_order(alone, tmp_path, at_once):
    project = fake_project(tmp_path / "two")
    summaries = of(project, workers=2).map_items("items", matrix_product, matrices(5))
    assert list(summaries) == ["m4", "m3", "m2", "m1", "m0"]
    assert (summaries, products(project)) == alone
    other = fake_project(tmp_path / "other")
    summaries = of(other, workers=2).map_items("items", matrix_product, matrices(5, tell=True))
    assert len({summary["pid"] for summary in summaries.values()}) >= 2


def test_linear_algebra_does_not_follow_the_number_of_threads(alone, tmp_path):
    rng = np.random.default_rng(4)
    a, b = rng.normal(size=(2, 500, 500))
    with threadpool_limits(1, user_api="blas"):
        expected = a @ b
    project = fake_project(tmp_path / "again")
    of(project, workers=1).map_items("items", matrix_product, matrices(5))
    assert np.array_equal(project.store.load("oriented_scans", "m4")["product"], expected)


def test_the_limit_of_threads_ends_with_its_block(monkeypatch):
    def threads() -> list[int]:
        return [of["num_threads"] for of in threadpool_info() if of["user_api"] == "blas"]

    monkeypatch.setenv("OPENBLAS_NUM_THREADS", "7")
    monkeypatch.delenv("MKL_NUM_THREADS", raising=False)
    before = threads()
    with one_blas_thread():
        assert set(threads()) == {1}
        # For the libraries that are yet to be loaded.
        assert os.environ["OPENBLAS_NUM_THREADS"] == os.environ["MKL_NUM_THREADS"] == "1"
    assert threads() == before
    assert os.environ["OPENBLAS_NUM_THREADS"] == "7"
    assert "MKL_NUM_THREADS" not in os.environ


def test_small_items_start_no_cluster(tmp_path, monkeypatch):
    def no_cluster(workers):
        raise AssertionError("a cluster was started")

    monkeypatch.setattr(cluster, "local_cluster", no_cluster)
    project = fake_project(tmp_path)
    summaries = of(project, workers=8).map_items("items", matrix_product, matrices(5, tell=True))
    assert {summary["pid"] for summary in summaries.values()} == {os.getpid()}
    monkeypatch.setattr(tasks, "run_item", no_cluster)
    again = of(project, workers=8).map_items("items", matrix_product, matrices(5, tell=True))
    assert again == summaries


def test_what_is_bound_to_the_main_thread_is_never_begun_in_another(alone, tmp_path):
    """PyMeshLab, first loaded by another thread than the main one, spoils its process."""
    project = fake_project(tmp_path / "bound")
    bound = of(project, workers=2, libraries=("numpy", "pymeshlab"))
    summaries = bound.map_items("items", matrix_product, matrices(5, tell=True))
    assert os.getpid() not in {summary["pid"] for summary in summaries.values()}
    other = fake_project(tmp_path / "other")
    assert (
        of(other, workers=2, libraries=("pymeshlab",)).map_items(
            "items", matrix_product, matrices(5)
        )
        == alone[0]
    )


def test_nothing_to_do_imports_no_dask(tmp_path):
    project = fake_project(tmp_path)
    of(project, workers=1).map_items("items", matrix_product, matrices(2))
    script = f"""
import sys
sys.path.insert(0, {str(Path(__file__).parent)!r})
from test_tasks import Project, matrices, matrix_product, of
of(Project({str(project.root)!r}), workers=2).map_items("items", matrix_product, matrices(2))
assert "distributed" not in sys.modules and "dask" not in sys.modules
"""
    subprocess.run([sys.executable, "-c", script], check=True, timeout=60)


def test_items_are_done_again_when_what_went_in_or_came_out_differs(tmp_path, monkeypatch):
    log = tmp_path / "log"
    monkeypatch.setenv("FAKE_ITEM_LOG", str(log))
    project = fake_project(tmp_path / "p")
    items = {name: {"name": f"{name}.xyz", "lines": [name]} for name in ("a", "b", "c")}

    def newly_done(**fields) -> list[str]:
        before = log.read_text().split() if log.exists() else []
        summaries = of(project, **fields).map_items("items", normals_of, items)
        # JSON knows no tuples: a summary is the same whether it was kept or made just now.
        assert set(map(str, summaries.values())) == {"{'bytes': 1, 'pair': [1, 2]}"}
        return log.read_text().split()[len(before) :]

    assert newly_done() == ["a.xyz", "b.xyz", "c.xyz"]
    assert newly_done() == []
    items["b"]["lines"] = ["B"]
    assert newly_done() == ["b.xyz"]
    path = project.store.path("oriented_scans", "c")
    content = bytearray(path.read_bytes())
    content[-1] ^= 1
    path.write_bytes(content)
    assert newly_done() == ["c.xyz"]
    path.unlink()
    assert newly_done() == ["c.xyz"]
    note = project.root / "work/fuse/items/normals_of/a.json"
    note.write_text("{}")
    assert newly_done() == ["a.xyz"]
    note.write_text(json.dumps({"key": 1, "written": [], "summary": []}))
    assert newly_done() == ["a.xyz"]


def test_an_item_touches_what_its_stage_declared(project):
    found = ItemProducts(ProductStore(project.root), ("scan_inventory",), ("oriented_scans",))
    found.save("oriented_scans", {"n": np.zeros(1)}, "a")
    assert found.load("oriented_scans", "a")["n"].tolist() == [0.0]
    with pytest.raises(PermissionError, match="truth_surface"):
        found.load("truth_surface")
    with pytest.raises(PermissionError, match="scan_inventory"):
        found.save("scan_inventory", {}, "a")


def test_items_of_a_run_that_has_ended_take_no_place(tmp_path):
    """A killed run's items may be at work elsewhere while the next run has other options."""
    project = fake_project(tmp_path)
    folder = RecordFolder(project, "fuse")
    ended, now = folder.start(), folder.start()
    path = project.store.path("oriented_scans", "m0")
    with pytest.raises(WorkbenchError, match="has ended"):
        of(project, asked_by=ended).map_items("items", matrix_product, matrices(1))
    assert list(path.parent.iterdir()) == []
    of(project, asked_by=now).map_items("items", matrix_product, matrices(1))
    assert path.exists()


def test_a_damaged_note_does_not_count(tmp_path):
    project = fake_project(tmp_path)
    first = of(project).map_items("items", matrix_product, matrices(1, tell=True))
    path = project.root / "work/fuse/items/matrix_product/m0.json"
    path.write_text(path.read_text().replace('"pid": ', '"pid": 1'))
    assert of(project).map_items("items", matrix_product, matrices(1, tell=True)) == first


@pytest.mark.parametrize("workers", [1, 2])
def test_an_error_in_an_item_arrives_as_itself(tmp_path, at_once, workers):
    project = fake_project(tmp_path)
    items = {name: {"name": name} for name in ("a", "b")}
    with pytest.raises(InputError) as caught:
        of(project, workers=workers).map_items("items", refuse, items)
    error = caught.value
    assert error.file in ("a.ply", "b.ply")
    assert (error.message, error.expected, error.found) == ("The scan is bad", "order", "chaos")
    assert any("while at work on" in note for note in error.__notes__)


def test_a_worker_that_dies_is_told_as_such(tmp_path, at_once, monkeypatch):
    monkeypatch.setenv("FAKE_MAIN_PID", str(os.getpid()))
    project = fake_project(tmp_path)
    items = {name: {"name": name} for name in ("a", "b")}
    with pytest.raises(WorkbenchError, match="workers died while at work on b") as caught:
        of(project, workers=2).map_items("items", die, items)
    assert "memory" in caught.value.fix


@pytest.mark.parametrize(
    "kind", [WorkbenchError, InputError, SettingsError, ProjectLockedError, MissingPartError]
)
def test_errors_survive_the_way_between_processes(kind):
    error = kind("m", stage="s", file=Path("f"), where="w", expected="e", found="g", fix="x")
    back = pickle.loads(pickle.dumps(error))
    assert type(back) is kind
    assert back.as_dict() == error.as_dict()
    assert str(back) == str(error)
    assert back.exit_code == error.exit_code


def test_an_outside_cluster_gives_the_same_and_is_checked_first(
    scheduler, alone, tmp_path, monkeypatch
):
    address, add_worker = scheduler
    assert address.startswith("tcp://")
    project = fake_project(tmp_path / "far")
    far = of(project, cluster=address, libraries=("numpy",))
    with monkeypatch.context() as impatient:
        impatient.setattr(cluster, "_ANSWER_SECONDS", 0.3)
        with pytest.raises(InputError, match="has no workers") as caught:
            far.map_items("items", matrix_product, matrices(5))
    assert f"dask worker {address}" in caught.value.fix
    add_worker()
    summaries = far.map_items("items", matrix_product, matrices(5))
    assert list(summaries) == ["m4", "m3", "m2", "m1", "m0"]
    assert (summaries, products(project)) == alone
    with pytest.raises(InputError) as caught:
        of(project, cluster=address).map_items("items", refuse, {"a": {"name": "a"}})
    assert caught.value.file == "a.ply"

    real = cluster.library_versions
    monkeypatch.setattr(cluster, "library_versions", lambda names: real(names) | {"numpy": "0.1"})
    with pytest.raises(InputError, match="another version of numpy") as caught:
        of(project, cluster=address).map_items("more", matrix_product, matrices(6))
    assert caught.value.expected == "0.1"
    monkeypatch.undo()
    (project.root / "project.toml").unlink()
    with pytest.raises(InputError, match="does not see the project folder"):
        of(project, cluster=address).map_items("more", matrix_product, matrices(6))


@pytest.mark.parametrize("address", ["tcp://127.0.0.1:9", "nonsense", "tcp://no.such.host:1", ""])
def test_an_address_where_nobody_answers_is_told(tmp_path, monkeypatch, address):
    def client(*_, **__):
        raise AssertionError("a client that cannot connect may stop others from starting, for ever")

    monkeypatch.setattr("distributed.Client", client)
    monkeypatch.setattr(cluster, "_ANSWER_SECONDS", 0.3)
    project = fake_project(tmp_path)
    with pytest.raises(InputError, match="does not answer") as caught:
        of(project, cluster=address).map_items("items", matrix_product, matrices(1))
    assert "dask scheduler" in caught.value.fix
    assert caught.value.exit_code == 2
