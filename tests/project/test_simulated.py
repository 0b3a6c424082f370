from __future__ import annotations

import pytest

from workbench.errors import InputError, SettingsError
from workbench.project import simulated
from workbench.project.simulated import simulate_project, simulation_options


class Silent:
    def line(self, text: str, *, transient: bool = False) -> None:
        pass


def fake_simulation(out, options, progress):
    (out / "scans").mkdir(parents=True)
    (out / "truth").mkdir()
    (out / "scans" / "scan_00.ply").write_text("ply")
    progress(1, 1, "scan_00")
    return out


@pytest.fixture
def make(tmp_path, monkeypatch):
    monkeypatch.setattr(simulated, "write_simulation", fake_simulation)

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
    def stopped(out, options, progress):
        fake_simulation(out, options, progress)
        raise KeyboardInterrupt

    monkeypatch.setattr(simulated, "write_simulation", stopped)
    with pytest.raises(KeyboardInterrupt):
        make()
    assert list(tmp_path.iterdir()) == []


def test_settings_reach_inside_and_mistakes_are_named():
    options = simulation_options(
        {"scene": "plane", "seed": 3, "scans": None},
        ["scanner.depth_sigma_m=0.002", "scans=4", "scanner.rows=50"],
    )
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
            simulation_options({}, [text])
        assert name in caught.value.message
        assert fix is None or caught.value.fix == fix
    with pytest.raises(SettingsError, match="not understood"):
        simulation_options({}, ["scans"])
