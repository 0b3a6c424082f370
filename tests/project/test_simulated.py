from __future__ import annotations

import pytest

from workbench.errors import InputError, SettingsError
from workbench.project import simulated
from workbench.project.simulated import simulate_project, simulation_order
from workbench.synthetic import photo_writing


class Silent:
    def line(self, text: str, *, transient: bool = False) -> None:
        pass


def fake_simulation(out, options, progress, scene):
    (out / "scans").mkdir(parents=True)
    (out / "truth").mkdir()
    (out / "scans" / "scan_00.ply").write_text("ply")
    progress(1, 1, "scan_00")
    return out


@pytest.fixture
def make(tmp_path, monkeypatch):
    monkeypatch.setattr(simulated, "write_simulation", fake_simulation)
    monkeypatch.setattr(simulated, "build_scene", lambda options: None)

    def simulate(**given):
        out = tmp_path / "out"
        preset = given.pop("preset", None)
        return simulate_project(
            out, given={"scene": "statue"} | given, preset=preset, progress=Silent()
        )

    return simulate


def test_a_simulation_becomes_a_project_with_the_preset_of_its_scene(make, tmp_path):
    project = make()
    assert project.name == "out"
    assert project.file.preset == "statue"
    assert project.file.inputs.scans == ("scans",)
    assert project.scene().truth
    assert [path.name for path in tmp_path.iterdir()] == ["out"]


def test_mistakes_are_found_before_anything_is_simulated(make, tmp_path):
    with pytest.raises(SettingsError, match="no preset"):
        make(preset="baroque")
    with pytest.raises(SettingsError):
        make(scene="teapot")
    assert list(tmp_path.iterdir()) == []


def test_what_is_there_is_never_mixed_with_a_simulation(make, tmp_path):
    (tmp_path / "out").mkdir()
    make()
    with pytest.raises(InputError, match="something already"):
        make()


def test_a_simulation_that_stops_leaves_nothing(make, tmp_path, monkeypatch):
    def stopped(out, options, progress, scene):
        fake_simulation(out, options, progress, scene)
        raise KeyboardInterrupt

    monkeypatch.setattr(simulated, "write_simulation", stopped)
    with pytest.raises(KeyboardInterrupt):
        make()
    assert list(tmp_path.iterdir()) == []


def test_settings_reach_inside_and_mistakes_are_named():
    options = simulation_order(
        {"scene": "plane", "seed": 3, "scans": None},
        ["scanner.depth_sigma_m=0.002", "scans=4", "scanner.rows=50"],
    ).scans
    assert (options.scans, options.seed, options.scanner.rows) == (4, 3, 50)
    assert options.scanner.depth_sigma_m == 0.002
    for text, name, fix in (
        ("scanner.row=3", "scanner.row", "did you mean 'rows'?"),
        ("scnner.rows=3", "scnner", "did you mean 'scanner'?"),
        ("scanner.rows=0", "scanner.rows", None),
        ("scanner=3", "scanner", None),
        ("scene.rows=3", "scene", None),
        ("size=tiny", "size", None),
    ):
        with pytest.raises(SettingsError) as caught:
            simulation_order({}, [text])
        assert name in caught.value.message
        assert fix is None or caught.value.fix == fix
    with pytest.raises(SettingsError, match="not understood"):
        simulation_order({}, ["scans"])


def test_settings_of_photographs_reach_them_and_share_size_and_seed():
    order = simulation_order(
        {"size": "medium", "seed": 9, "photos": 5},
        ["photos.flash.mode=ttl", "photos.camera.iso=400", "scans=2"],
    )
    assert order.photos is not None
    assert (order.scans.scans, order.photos.photos, order.photos.seed) == (2, 5, 9)
    assert (order.photos.flash.mode, order.photos.camera.iso) == ("ttl", 400)
    assert order.photos.camera.long_side_px == 3000
    assert simulation_order({"photos": 0}, []).photos is None
    for given, text, words in (
        ({"photos": 3}, "photos.flsh.mode=ttl", "photos.flsh"),
        ({"photos": 3}, "photos.flash.mode=strobe", "photos.flash.mode"),
        ({}, "photos.flash.mode=ttl", "No photographs"),
    ):
        with pytest.raises(SettingsError) as caught:
            simulation_order(given, [text])
        assert words in caught.value.message


def test_a_building_is_photographed_by_daylight_unless_told_otherwise():
    order = simulation_order(
        {"scene": "building", "photos": 3}, ["photos.path.distance_m=9", "photos.flash.sky=0.5"]
    )
    assert order.photos is not None
    flash, path = order.photos.flash, order.photos.path
    assert (flash.mode, flash.sky, path.kind, path.distance_m) == ("off", 0.5, "along walls", 9.0)
    statue = simulation_order({"photos": 3}, []).photos
    assert statue is not None
    assert (statue.flash.mode, statue.flash.sky) == ("manual", 0.0)


SMALL = (
    "photos.camera.long_side_px=60",
    "photos.camera.short_side_px=40",
    "photos.charts.color_frames=1",
    "photos.charts.flat_frames=0",
    "photos.charts.linearity_distances_m=[]",
    "photos.surface.indirect_rays=0",
    "scanner.rows=30",
    "scanner.cols=30",
)


def stopping_after(count):
    """Progress that interrupts once so many photographs are done; it keeps what it was told."""

    class Stopping(Silent):
        def __init__(self):
            self.told = []

        def line(self, text, *, transient=False):
            self.told.append(text)
            if f"{count}/5" in text and "photo" in text:
                raise KeyboardInterrupt

    return Stopping()


def files(folder):
    return {
        str(path.relative_to(folder)): path.read_bytes()
        for path in folder.rglob("*")
        if path.is_file()
    }


def test_a_stopped_simulation_goes_on_where_it_stopped(tmp_path, monkeypatch):
    given = {"scene": "sphere", "scans": 1, "photos": 4}
    whole = tmp_path / "whole" / "out"
    whole.parent.mkdir()
    simulate_project(whole, given=given, settings=SMALL, progress=Silent(), workers=1)
    out = tmp_path / "stopped" / "out"
    out.parent.mkdir()
    stopping = stopping_after(3)
    with pytest.raises(KeyboardInterrupt):
        simulate_project(out, given=given, settings=SMALL, progress=stopping, workers=1)
    assert not out.exists()
    assert "goes on from there" in stopping.told[-1]
    taken = []
    take = photo_writing.write_photograph
    monkeypatch.setattr(
        photo_writing,
        "write_photograph",
        lambda *args: (taken.append(args[3].name), take(*args))[1],
    )
    monkeypatch.setattr(simulated, "write_simulation", lambda *args: pytest.fail("scanned again"))
    simulate_project(out, given=given, settings=SMALL, progress=Silent(), workers=1)
    assert 1 <= len(taken) <= 2
    assert files(out) == files(whole)
    assert [path.name for path in out.parent.iterdir()] == ["out"]


def test_other_options_do_not_go_on_from_what_was_stopped(tmp_path):
    out = tmp_path / "out"
    given = {"scene": "sphere", "scans": 1, "photos": 4}
    with pytest.raises(KeyboardInterrupt):
        simulate_project(out, given=given, settings=SMALL, progress=stopping_after(2), workers=1)
    simulate_project(out, given=given | {"seed": 1}, settings=SMALL, progress=Silent(), workers=1)
    fresh = tmp_path / "fresh"
    simulate_project(fresh, given=given | {"seed": 1}, settings=SMALL, progress=Silent(), workers=1)
    found, expected = files(out), files(fresh)
    found.pop("project.toml"), expected.pop("project.toml")
    assert found == expected
