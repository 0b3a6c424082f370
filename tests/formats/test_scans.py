from __future__ import annotations

import numpy as np
import pytest

from workbench.errors import InputError
from workbench.formats.poses import write_aln, write_conf, write_scan_poses_json
from workbench.formats.scans import (
    ScanListing,
    find_scans,
    read_pose_files,
    read_scans,
    require_matching_poses,
    unmatched_poses,
)
from workbench.geometry.transforms import rigid


@pytest.fixture
def folder(tmp_path, valid_files):
    (tmp_path / "reference").mkdir()
    (tmp_path / "reference" / "model.ply").write_bytes(valid_files["little.ply"])
    (tmp_path / "b.ply").write_bytes(valid_files["text.ply"])
    (tmp_path / "a.PTX").write_bytes(valid_files["two.ptx"])
    (tmp_path / "notes.txt").write_text("Scanned on Monday.\n3 scans, 2 of them good\n")
    (tmp_path / "points.txt").write_text("x y z\n1 2 3\n")
    (tmp_path / "README").write_text("1 2 3")
    (tmp_path / ".hidden.ply").write_text("ply")
    return tmp_path


def named(paths):
    return [path.name for path in paths]


def test_a_folder_gives_its_scans_and_its_pose_files(folder):
    write_conf(folder / "x.conf", {"b.ply": np.eye(4)})
    write_scan_poses_json(folder / "scan_poses.json", {"b": np.eye(4)}, [0, 0, 0])
    (folder / "other.json").write_text("{}")
    listing = find_scans([folder])
    assert named(listing.files) == ["a.PTX", "b.ply", "points.txt"]
    assert named(listing.pose_files) == ["scan_poses.json", "x.conf"]
    assert find_scans([folder / "b.ply", folder, folder / "x.conf"]).files[0].name == "b.ply"
    assert len(find_scans([folder, folder]).files) == 3


def test_links_keep_the_name_the_user_sees(folder):
    (folder / "link.ply").symlink_to(folder / "reference" / "model.ply")
    assert "link.ply" in named(find_scans([folder]).files)


@pytest.mark.parametrize("name", ["absent.ply", "README", "reference/none", "empty", ""])
def test_what_holds_no_scans_is_refused_with_the_extensions(folder, name):
    (folder / "empty").mkdir()
    paths = [folder / name] if name else []
    with pytest.raises(InputError) as caught:
        find_scans(paths)
    if name in ("README", "empty", ""):
        assert ".e57" in str(caught.value)
        assert ".ptx" in str(caught.value)


def test_names_are_unique_and_do_not_run_into_numbered_scans(tmp_path):
    files = [
        tmp_path / part
        for part in (
            "a/s.ply",
            "b/s.ply",
            "c/S.pcd",
            "hall_001.ply",
            "hall.e57",
            "é ü.xyz",
            "hall-2_000.ply",
        )
    ]
    names = ScanListing(tuple(files), ()).names
    assert names == ("s", "s-2", "S-3", "hall_001", "hall-2", "___", "hall-2_000-2")


def test_a_pose_file_wins_and_says_so(folder):
    pose = rigid(np.eye(3), [1, 2, 3])
    first, second = read_scans(folder / "a.PTX", {"a_001": pose}, "hall")
    assert [first.range_map.name, second.range_map.name] == ["hall_000", "hall_001"]
    assert np.array_equal(second.range_map.world_from_scan, first.range_map.world_from_scan)
    first, second = read_scans(folder / "a.PTX", {"hall_001": pose}, "hall")
    assert not np.array_equal(first.range_map.world_from_scan, pose)
    assert np.array_equal(second.range_map.world_from_scan, pose)
    assert any("gives way" in note for note in second.notes)
    (reading,) = read_scans(folder / "b.ply", {"some/where/b.ply": pose})
    assert reading.range_map.name == "b"
    assert np.array_equal(reading.range_map.world_from_scan, pose)
    (reading,) = read_scans(folder / "b.ply", {})
    assert reading.range_map.world_from_scan is None


def test_poses_that_contradict_or_do_not_decide_are_refused(folder):
    pose = rigid(np.eye(3), [1, 2, 3])
    with pytest.raises(InputError, match="two different poses"):
        read_scans(folder / "b.ply", {"b.ply": pose, "b": np.eye(4)})
    with pytest.raises(InputError, match="holds 2 scans"):
        read_scans(folder / "a.PTX", {"a.PTX": pose})
    write_conf(folder / "x.conf", {"b.ply": pose})
    write_aln(folder / "y.aln", {"b.ply": np.eye(4)})
    with pytest.raises(InputError, match="two different poses") as caught:
        read_pose_files([folder / "x.conf", folder / "y.aln"])
    assert "x.conf" in str(caught.value)
    write_aln(folder / "y.aln", {"b.ply": pose})
    assert list(read_pose_files([folder / "x.conf", folder / "y.aln"])) == ["b.ply"]


def test_poses_of_the_workbench_file_are_in_the_users_world(folder):
    write_scan_poses_json(
        folder / "scan_poses.json", {"b": rigid(np.eye(3), [1, 1, 1])}, [10, 20, 30]
    )
    poses = read_pose_files([folder / "scan_poses.json"])
    assert poses["b"][:3, 3].tolist() == [1, 1, 1]


def test_poses_that_match_nothing_are_named(folder):
    write_conf(folder / "x.conf", {"b.ply": np.eye(4)})
    listing = find_scans([folder / "b.ply", folder / "a.PTX"])
    poses = dict.fromkeys(["b.ply", "b", "a_000", "points.txt", "c.ply", "b_000"], np.eye(4))
    # points.txt lies beside the pose file and was left out on purpose.
    assert unmatched_poses(listing, poses) == ("c.ply", "b_000")
    with pytest.raises(InputError, match="2 of 6 poses") as caught:
        require_matching_poses(listing, poses)
    assert "c.ply" in str(caught.value)
    require_matching_poses(listing, {"b.ply": np.eye(4)})


def test_the_bunny_is_found_with_its_poses(shared_data):
    listing = find_scans([shared_data("stanford-bunny")])
    assert len(listing.files) == 10
    assert named(listing.pose_files) == ["bun.conf"]
    poses = read_pose_files(listing.pose_files)
    require_matching_poses(listing, poses)
    (reading,) = read_scans(listing.files[1], poses, listing.names[1])
    assert reading.range_map.name == "bun045"
    assert np.array_equal(reading.range_map.world_from_scan, poses["bun045.ply"])
