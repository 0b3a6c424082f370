"""The page measured: every form opens without a word of complaint and agrees with its twin."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.viewer.looking import HEIGHT, WIDTH
from workbench.cli import run_cli
from workbench.pipeline.progress import Progress
from workbench.project.project import Project
from workbench.viewer import page_browser
from workbench.viewer.page_measures import MeasureOptions, page_measures, path_around
from workbench.viewer.site import Site


@pytest.mark.parametrize(
    "modes",
    [("surface", "graph"), pytest.param(("surfels", "voxels"), marks=pytest.mark.slow)],
)
def test_forms_are_measured_and_agree_with_and_without_a_browser(
    project: Project, site: Site, browser, modes: tuple[str, ...]
):
    chosen = [entry for entry in site.scene["modes"] if entry["mode"] in modes]
    site = replace(site, scene=site.scene | {"modes": chosen})
    options = MeasureOptions(4, 5.0, WIDTH, HEIGHT, 64 << 20, (1.0, 4.0))
    told = page_measures(browser, project, site, options, Progress(quiet=True))
    assert told["card"]
    assert tuple(form["mode"] for form in told["forms"]) == modes
    for form in told["forms"]:
        mode = form["mode"]
        assert form["told"] == [], mode
        assert 0 < form["first_bytes"] <= form["full_bytes"] <= form["path"][-1]["read_bytes"]
        assert form["full_bytes"] < 1.1 * form["file_bytes"] + 10_000, mode
        assert 0 < form["end_card_bytes"] < 64 << 20, mode
        assert all(row["frame_ms"] > 0 and row["items"] > 0 for row in form["path"]), mode
        assert all(row["headless"] > 0.98 for row in form["compared"]), (mode, form["compared"])
        assert form["compared"][0]["rays"] > 0.9, (mode, form["compared"])
        # Coarser is never nearer to the truth by more than chance.
        if form["errors"]:
            fine, coarse = form["errors"]
            assert coarse["error"] > fine["error"] - 0.005, mode


def test_the_path_goes_round_and_nearer():
    views = path_around(np.array([0.0, -6.0, 3.0]), 8)
    eyes = np.array([view.eye for view in views])
    assert eyes[0] == pytest.approx([0, -6, 3])
    away = np.linalg.norm(eyes, axis=1)
    assert (np.diff(away) < 0).all()
    np.testing.assert_allclose(eyes[:, 2] / away, eyes[0, 2] / away[0])
    assert away[-1] > away[0] / 3
    turns = np.unwrap(np.arctan2(eyes[:, 1], eyes[:, 0]))
    np.testing.assert_allclose(np.diff(turns), np.pi / 4)


def test_without_a_browser_it_says_what_is_missing(project: Project, tmp_path, monkeypatch, capsys):
    pytest.importorskip("playwright")
    monkeypatch.setattr(page_browser, "_BROWSERS", ("no-such-browser",))
    given = ["publish", str(project.root), "--out", str(tmp_path / "site"), "--resolution", "64"]
    given += ["--surfels", "500", "--measure"]
    assert run_cli((), given) == 3
    assert "chromium" in capsys.readouterr().err
    # What was published is there all the same.
    assert (tmp_path / "site" / "scene.json").exists()
