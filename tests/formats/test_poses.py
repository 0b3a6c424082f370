from __future__ import annotations

import json

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from workbench.errors import InputError
from workbench.formats.poses import (
    read_aln,
    read_conf,
    read_scan_poses_json,
    write_aln,
    write_conf,
    write_scan_poses_json,
)
from workbench.geometry.transforms import apply, from_twist, is_rigid


def saved(tmp_path, name, text):
    path = tmp_path / name
    path.write_text(text)
    return path


EYE = "1 0 0 0\n0 1 0 0\n0 0 1 0\n0 0 0 1\n"

POSES = {
    name: from_twist(np.random.default_rng(k).standard_normal(6) * [1, 1, 1, 1e6, 10, 1])
    for k, name in enumerate(["a.ply", "scan two.e57", "büste.ptx"])
}


def test_conf_turns_with_the_transposed_rotation(tmp_path):
    # 90° about z: R x = y, so Rᵀ takes y to x.
    half = np.sqrt(0.5)
    text = f"camera 0 0 0 0 0 0 1\nmesh m.ply 0 0 0 0 0 0 1\nbmesh a.ply 1 2 3 0 0 {half} {half}\n"
    (pose,) = read_conf(saved(tmp_path, "a.conf", text)).values()
    assert np.allclose(apply(pose, [0, 1, 0]), [2, 2, 3])


def test_aln_is_read_row_by_row(tmp_path):
    text = f"2\na b.ply\n#\n0 -1 0 5\n1 0 0 6\n0 0 1 7\n0 0 0 1\nc.ply\n#\n{EYE}0\n"
    poses = read_aln(saved(tmp_path, "a.aln", text))
    assert list(poses) == ["a b.ply", "c.ply"]
    assert apply(poses["a b.ply"], [1, 0, 0]).tolist() == [5, 7, 7]


def test_every_format_keeps_full_precision(tmp_path):
    write_conf(tmp_path / "p.conf", POSES)
    write_aln(tmp_path / "p.aln", POSES)
    write_scan_poses_json(tmp_path / "p.json", POSES, [5.4e6 + 1 / 3, 0, -1])
    conf, aln = read_conf(tmp_path / "p.conf"), read_aln(tmp_path / "p.aln")
    own = read_scan_poses_json(tmp_path / "p.json")
    assert own.origin.tolist() == [5.4e6 + 1 / 3, 0, -1]
    for name, pose in POSES.items():
        assert np.array_equal(aln[name], pose)
        assert np.array_equal(own.world_from_scan[name], pose)
        assert np.array_equal(conf[name][:3, 3], pose[:3, 3])
        assert np.abs(conf[name] - pose).max() < 1e-15
    assert list(conf) == list(aln) == list(own.world_from_scan) == list(POSES)
    first = (tmp_path / "p.aln").read_bytes()
    write_aln(tmp_path / "p.aln", aln)
    assert (tmp_path / "p.aln").read_bytes() == first


def test_rounded_matrices_are_made_rigid(tmp_path):
    rotation = np.round(Rotation.from_rotvec([0.3, 0.7, -0.4]).as_matrix(), 4)
    rows = "\n".join(" ".join(map(str, [*row, 1.5])) for row in rotation)
    pose = read_aln(saved(tmp_path, "a.aln", f"1\na\n#\n{rows}\n0 0 0 1\n0\n"))["a"]
    assert is_rigid(pose, 1e-14)
    assert np.abs(pose[:3, :3] - rotation).max() < 1e-4


@pytest.mark.parametrize(
    ("name", "text", "message"),
    [
        ("a.conf", "bmesh a 0 0 0 0 0 0 1\nbmesh b 0 0 0 0 0 1\n", "line 2"),
        ("a.conf", "bmesh a 0 0 0 0 0 0 nan\n", "line 1"),
        ("a.conf", "\nbmesh a 0 0 0 0 0 0 0\n", "line 2"),
        ("a.conf", "bmesh 0 0 0 0 0 0 1\n", "line 1"),
        ("a.conf", "bmesh a 0 0 0 0 0 0 1\nbmesh a 0 0 0 0 0 0 1\n", "line 2"),
        ("a.conf", "wmesh a 0 0 0 0 0 0 1\n", "line 1"),
        ("a.conf", "camera 0 0 0 0 0 0 1\n", "no bmesh"),
        ("a.aln", "two\n", "line 1"),
        ("a.aln", f"2\na\n#\n{EYE}0\n", "line 8"),
        ("a.aln", f"1\na\n{EYE}0\n", "line 3"),
        ("a.aln", "1\na\n#\n1 0 0 0\n0 1 0\n0 0 1 0\n0 0 0 1\n0\n", "line 5"),
        ("a.aln", "1\na\n#\n1 0 0 0\n0 1 0 x\n0 0 1 0\n0 0 0 1\n0\n", "line 5"),
        ("a.aln", f"1\na\n#\n{EYE.replace('1', '2', 1)}0\n", "rigid"),
        ("a.aln", f"1\na\n#\n{EYE.replace('1', '-1', 1)}0\n", "rigid"),
        ("a.json", "[1, 2", "not JSON"),
        ("a.json", "[" * 100_000, "not JSON"),
        ("a.json", "[]", '"scans"'),
        ("a.json", '{"scans": {}}', "no scans"),
        ("a.json", '{"scans": {"a": [1]}}', '"a"'),
        ("a.json", '{"scans": {"a": {"world_from_scan": [[1, 0], [0, 1]]}}}', '"a"'),
        ("a.json", '{"scans": {"a": {"world_from_scan": [[1e999]]}}}', '"a"'),
        ("a.json", '{"origin": "here", "scans": {}}', '"origin"'),
        ("a.json", '{"scans": {}, "scans": {}}', "twice"),
    ],
)
def test_what_is_wrong_is_said_with_its_line(tmp_path, name, text, message):
    reader = {"conf": read_conf, "aln": read_aln, "json": read_scan_poses_json}[name[2:]]
    with pytest.raises(InputError) as caught:
        reader(saved(tmp_path, name, text))
    assert message in str(caught.value)
    assert caught.value.fix


def test_json_that_is_not_rigid_names_the_scan(tmp_path):
    content = {"scans": {"left": {"world_from_scan": np.diag([1.0, 1, 1.1, 1]).tolist()}}}
    with pytest.raises(InputError, match="cannot be used") as caught:
        read_scan_poses_json(saved(tmp_path, "a.json", json.dumps(content)))
    assert "left" in str(caught.value)


@pytest.mark.parametrize("name", ["", "a\nb", " a"])
def test_names_a_format_cannot_hold_are_refused(tmp_path, name):
    for write, path in ((write_conf, tmp_path / "a.conf"), (write_aln, tmp_path / "a.aln")):
        with pytest.raises(InputError, match="cannot hold"):
            write(path, {name: np.eye(4)})
        assert not path.exists()
