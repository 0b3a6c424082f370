"""The command bake: what it tells, and what it refuses."""

from __future__ import annotations

import json

import numpy as np

from tests.raytracing.scenes import sheet
from workbench.formats.ply import read_ply
from workbench.formats.surface_files import write_surface_ply


def test_values_are_written_within_little_memory_and_told(cli, tmp_path):
    write_surface_ply(tmp_path / "in.ply", sheet(150))
    answers = {}
    for memory in (3, 500):
        out = tmp_path / f"{memory}.ply"
        code, answers[memory] = cli(
            "bake", tmp_path / "in.ply", "--out", out, "--memory-mb", memory, "--samples", 4
        )
        assert code == 0
        columns = read_ply(out).elements["vertex"].columns
        assert 0.3 < columns["ambient_occlusion"].mean() < 1.0
        # A quarter of the diagonal is the reach by default, and half of that the largest ball.
        assert np.isclose(columns["accessibility"].max(), 0.5 * answers[memory]["reach"])
        assert answers[memory]["rays"] == 4 * 151**2
    assert not answers[3]["in_core"]
    assert answers[3]["queries"] > 0 < answers[3]["bytes_read"]
    assert answers[500]["in_core"]
    assert answers[500]["bytes_read"] == 0


def test_what_cannot_be_done_is_refused_before_any_ray(cli, tmp_path):
    write_surface_ply(tmp_path / "in.ply", sheet(5))
    (tmp_path / "text.ply").write_text("ply\nformat ascii 1.0\nelement vertex 0\nend_header\n")
    out = ("--out", tmp_path / "out.ply")
    for said, arguments in {
        "did you mean 'occlusion'": ("in.ply", *out, "--what", "oclusion"),
        "over itself": ("in.ply", "--out", tmp_path / "in.ply"),
        "a .ply file": ("in.ply", "--out", tmp_path / "out.obj"),
        "read in parts": ("text.ply", *out),
        "does not exist": ("none.ply", *out),
        "no length": ("in.ply", *out, "--reach", -1),
    }.items():
        code, told = cli("bake", tmp_path / arguments[0], *arguments[1:])
        assert code != 0
        assert said in json.dumps(told)
    assert not (tmp_path / "out.ply").exists()
