from __future__ import annotations

import numpy as np
import pytest

from workbench.errors import InputError
from workbench.geometry.mesh import TriangleMesh
from workbench.geometry.rangemap import RangeMap
from workbench.project.store import ProductStore


@pytest.fixture
def store(tmp_path) -> ProductStore:
    return ProductStore(tmp_path / "[odd] *name?")


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(7)


def range_map(rng, full: bool) -> RangeMap:
    return RangeMap(
        "a.b-1",
        rng.normal(size=(6, 3)),
        np.array([[0, 1, -1], [2, 3, 5]], np.int32) if full else None,
        rng.normal(size=3) if full else None,
        rng.random(6).astype(np.float32) if full else None,
        rng.integers(0, 256, (6, 3), np.uint8) if full else None,
        np.eye(4) if full else None,
    )


@pytest.mark.parametrize("full", [True, False])
def test_a_range_map_comes_back_as_it_was(store, rng, full):
    scan = range_map(rng, full)
    store.save("range_maps", scan, "a.b-1")
    back = store.load("range_maps", "a.b-1")
    assert back.name == scan.name
    for field in ("points_in_scan", "grid", "viewpoint_in_scan", "reflectance", "color"):
        before, after = getattr(scan, field), getattr(back, field)
        assert (before is None) == (after is None)
        if before is not None:
            assert np.array_equal(before, after)
            assert before.dtype == after.dtype


def test_a_mesh_comes_back_with_its_attributes(store, rng):
    mesh = TriangleMesh(
        rng.normal(size=(4, 3)),
        np.array([[0, 1, 2], [1, 2, 3]], np.int32),
        {"provenance": np.array([0, 1, 0, 1], np.uint8), "normal": rng.normal(size=(4, 3))},
    )
    store.save("surface", mesh)
    back = store.load("surface")
    assert np.array_equal(back.vertices, mesh.vertices)
    assert np.array_equal(back.triangles, mesh.triangles)
    assert set(back.vertex_attributes) == {"provenance", "normal"}
    assert back.vertex_attributes["provenance"].dtype == np.uint8


def test_the_same_value_gives_the_same_bytes(store, rng, monkeypatch):
    arrays = {"b": rng.normal(size=5), "a": np.arange(3)}
    first = store.save("samples", arrays).read_bytes()
    monkeypatch.setattr("time.time", lambda: 2e9)
    assert store.save("samples", arrays).read_bytes() == first
    assert set(store.load("samples")) == {"a", "b"}
    assert set(store.load("samples", only=["a"])) == {"a"}
    with pytest.raises(InputError, match="damaged"):
        store.load("samples", only=["c"])


def test_arrays_of_objects_are_refused(store):
    with pytest.raises(ValueError, match=r"[Oo]bject"):
        store.save("samples", {"a": np.array([None, {}], object)})
    assert not store.exists("samples")


def test_numbers_json_does_not_know_are_refused(store):
    with pytest.raises(ValueError, match="JSON"):
        store.save("scan_inventory", {"a": float("nan")})
    assert store.paths("scan_inventory") == ()


def test_items_are_listed_sorted_without_what_is_half_written(store):
    for item in ("b", "a.1", "c"):
        store.save("oriented_scans", {"n": np.zeros(1)}, item)
    path = store.path("oriented_scans", "b")
    path.with_name(".d.npz.partial").write_bytes(b"half")
    assert store.items("oriented_scans") == ("a.1", "b", "c")
    assert store.paths("oriented_scans")[1] == path
    store.save("records", {}, "fuse")
    store.save("records", {}, "ingest")
    assert store.items("records") == ("fuse", "ingest")


@pytest.mark.parametrize("item", ["", ".", "..", "a/b", "../a"])
def test_an_item_cannot_lie_elsewhere(store, item):
    with pytest.raises(ValueError, match="cannot be the name"):
        store.path("oriented_scans", item)


def test_a_place_is_asked_for_as_the_table_says(store):
    with pytest.raises(ValueError, match="item missing"):
        store.path("oriented_scans")
    with pytest.raises(ValueError, match="item not expected"):
        store.path("samples", "a")
    with pytest.raises(ValueError, match="no fixed place"):
        store.path("scan_files")
    with pytest.raises(ValueError, match="not in the artefact table"):
        store.path("nonsense")
    with pytest.raises(ValueError, match=r"writing\(\)"):
        store.save("surface_ply", b"")


def test_what_is_not_there_is_told_by_its_path(store):
    with pytest.raises(InputError, match="not there") as caught:
        store.load("samples")
    assert caught.value.file == str(store.path("samples"))


def test_an_error_while_writing_leaves_the_old_file(store):
    store.save("scan_inventory", {"a": 1})
    with pytest.raises(ZeroDivisionError), store.writing("scan_inventory") as path:
        path.write_text(f"half {1 / 0}")
    assert store.load("scan_inventory") == {"a": 1}
    assert len(list(store.path("scan_inventory").parent.iterdir())) == 1


@pytest.mark.parametrize("name", ["range_maps", "surface", "samples", "scan_inventory"])
def test_whatever_is_damaged_is_a_plain_error_or_still_readable(store, rng, name):
    item = "a" if name == "range_maps" else None
    value = {
        "range_maps": lambda: range_map(rng, True),
        "surface": lambda: TriangleMesh(
            rng.normal(size=(4, 3)), np.array([[0, 1, 2], [1, 2, 3]], np.int32), {}
        ),
        "samples": lambda: {"points": rng.normal(size=(5, 3))},
        "scan_inventory": lambda: {"scans": ["ä"] * 5},
    }[name]()
    path = store.save(name, value, item)
    good = path.read_bytes()
    damaged = [good[:length] for length in rng.integers(0, len(good), 40)]
    for position in rng.integers(0, len(good), 400):
        flipped = bytearray(good)
        flipped[position] ^= 1 << int(rng.integers(8))
        damaged.append(bytes(flipped))
    refused = []
    for content in damaged:
        path.write_bytes(content)
        try:
            store.load(name, item)
        except InputError as error:
            refused.append(error)
    assert len(refused) >= 40
    assert {error.file for error in refused} == {str(path)}
    assert all("--force" in error.fix for error in refused)
