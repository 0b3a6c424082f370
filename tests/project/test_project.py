from __future__ import annotations

import numpy as np
import pytest

from workbench.errors import InputError, SettingsError
from workbench.formats.poses import read_conf, write_conf, write_scan_poses_json
from workbench.formats.scans import read_pose_files, require_matching_poses
from workbench.geometry.transforms import rigid
from workbench.project import creation
from workbench.project.creation import create_project
from workbench.project.project import Project, find_photos


@pytest.fixture
def scans(tmp_path):
    folder = tmp_path / "scans"
    folder.mkdir()
    for name in ("a", "b"):
        (folder / f"{name}.xyz").write_text("0 0 0\n")
    return folder


def put(path, text="v 0 0 0\n"):
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text)
    return path


def test_inputs_stay_where_they_are_and_are_named_relative(scans, tmp_path):
    project = create_project(tmp_path / "p", scans=[scans])
    assert project.file.inputs.scans == ("../scans",)
    assert [path.name for path in project.input_paths("scan_files")] == ["a.xyz", "b.xyz"]
    assert sorted(path.name for path in project.root.iterdir()) == ["project.toml"]
    scene = project.scene()
    assert (scene.scans, scene.poses, scene.photos) == (2, False, 0)
    assert scene.scan_bytes == 12
    inside = create_project(scans, scans=[scans / "a.xyz"])
    assert inside.file.inputs.scans == ("a.xyz",)
    with pytest.raises(InputError, match="There is a project already"):
        create_project(scans, scans=[scans])


def test_every_input_is_known_to_the_scene(scans, tmp_path):
    model = put(tmp_path / "model.ply")
    put(tmp_path / "cameras" / "images.txt")
    put(tmp_path / "cameras" / ".hidden")
    photo = put(tmp_path / "photos" / "1.NEF")
    project = create_project(
        tmp_path / "p", photos=[photo.parent], geometry=model, cameras=tmp_path / "cameras",
        reference=model,
    )  # fmt: skip
    scene = project.scene()
    assert (scene.scans, scene.photos) == (0, 1)
    assert scene.geometry
    assert scene.cameras
    assert scene.reference
    assert not scene.truth
    assert project.input_paths("scan_files") == project.input_paths("pose_files") == ()
    assert [path.name for path in project.input_paths("camera_files")] == ["images.txt"]
    # What has gone missing is told before anything is computed.
    model.unlink()
    with pytest.raises(InputError, match="not there") as caught:
        Project(project.root).scene()
    assert caught.value.file == str(model)
    assert "project.toml" in caught.value.fix


def test_a_reference_beside_the_scans_is_taken(scans, tmp_path):
    put(scans / "reference" / "model.PLY")
    put(scans / "reference" / "README")
    project = create_project(tmp_path / "p", scans=[scans])
    assert project.file.inputs.reference == "../scans/reference/model.PLY"
    put(scans / "reference" / "second.ply")
    assert create_project(tmp_path / "q", scans=[scans]).file.inputs.reference is None


def test_a_link_keeps_the_name_it_is_known_by(scans, tmp_path):
    stored = put(tmp_path / "store" / "SHA256E-s6--0f1e", "0 0 0\n")
    link = tmp_path / "delivery" / "scan_07.xyz"
    link.parent.mkdir()
    link.symlink_to(stored)
    folder = tmp_path / "linked"
    folder.symlink_to(scans)
    project = create_project(tmp_path / "p", scans=[link, folder])
    assert project.file.inputs.scans == ("../delivery/scan_07.xyz", "../linked")
    assert [path.name for path in project.input_paths("scan_files")] == [
        *("scan_07.xyz", "a.xyz", "b.xyz")
    ]


def test_relative_paths_are_those_of_the_caller(scans, tmp_path, monkeypatch):
    monkeypatch.chdir(scans)
    from pathlib import Path

    project = create_project(Path("../p"), scans=[Path()])
    assert project.file.inputs.scans == ("../scans",)
    assert len(Project(Path("../p")).input_paths("scan_files")) == 2


def test_photographs_are_found_one_level_deep_without_hidden_ones(tmp_path):
    folder = tmp_path / "photos"
    for name in ("b.JPG", "a.nef", "._a.nef", "notes.txt", "deep/c.jpg"):
        put(folder / name)
    (folder / "folder.jpg").mkdir()
    found = find_photos([folder, folder / "a.nef"])
    assert [path.name for path in found] == ["a.nef", "b.JPG"]
    with pytest.raises(InputError, match="No photographs"):
        find_photos([folder / "notes.txt"])
    with pytest.raises(InputError, match="no such"):
        find_photos([folder / "x.jpg"])


def test_copies_keep_everything_under_its_own_name(tmp_path):
    first, second = tmp_path / "1" / "scans", tmp_path / "2" / "scans"
    for folder, text in ((first, "1 1 1\n"), (second, "2 2 2\n")):
        put(folder / "a.xyz", text)
        put(folder / "deep" / "work.bin")
    model = put(tmp_path / "3" / "a.ply", "geometry")
    reference = put(tmp_path / "4" / "a.ply", "reference")
    photos = [put(tmp_path / f"{n}" / "IMG_1.jpg", str(n)) for n in (5, 6)]
    project = create_project(
        tmp_path / "p", scans=[first, second], photos=photos, geometry=model,
        reference=reference, copy=True,
    )  # fmt: skip
    for folder in "123456":
        for path in sorted((tmp_path / folder).rglob("*.*")):
            path.unlink()
    project = Project(project.root)
    assert [p.read_text() for p in project.input_paths("scan_files")] == ["1 1 1\n", "2 2 2\n"]
    assert [p.read_text() for p in project.input_paths("photo_files")] == ["5", "6"]
    assert [p.name for p in project.input_paths("photo_files")] == ["IMG_1.jpg"] * 2
    assert project.input_paths("geometry_file")[0].read_text() == "geometry"
    assert project.input_paths("reference_file")[0].read_text() == "reference"
    assert not list(project.root.rglob("work.bin"))
    assert all(not entry.startswith("..") for entry in project.file.inputs.scans)


def test_copied_links_become_files(scans, tmp_path):
    (scans / "link.xyz").symlink_to(scans / "a.xyz")
    project = create_project(tmp_path / "p", scans=[scans], copy=True)
    assert len(project.input_paths("scan_files")) == 3
    assert not any(path.is_symlink() for path in project.root.rglob("*"))


def test_scans_copied_one_by_one_keep_their_own_poses_and_no_others(scans, tmp_path):
    poses = {f"{name}.xyz": rigid(np.eye(3), [n, 2, 3]) for n, name in enumerate("abc")}
    write_conf(scans / "x.conf", poses)
    put(scans / "c.xyz", "0 0 0\n")
    chosen = [scans / "c.xyz", scans / "a.xyz"]
    project = create_project(tmp_path / "p", scans=chosen, copy=True)
    listing = project.scan_listing
    assert [path.name for path in listing.files] == ["c.xyz", "a.xyz"]
    found = read_pose_files(listing.pose_files)
    require_matching_poses(listing, found)
    exact = read_conf(scans / "x.conf")
    assert set(found) == {"a.xyz", "c.xyz"}
    assert all(np.array_equal(found[name], exact[name]) for name in found)


def test_a_copied_folder_takes_its_poses_as_they_are(scans, tmp_path):
    write_scan_poses_json(scans / "scan_poses.json", {"a": np.eye(4), "b": np.eye(4)}, [0, 0, 0])
    project = create_project(tmp_path / "p", scans=[scans], copy=True)
    (copied,) = project.input_paths("pose_files")
    assert copied.read_bytes() == (scans / "scan_poses.json").read_bytes()


def test_a_copy_into_its_own_source_ends(scans):
    project = create_project(scans / "p", scans=[scans], copy=True)
    assert len(project.input_paths("scan_files")) == 2


def test_a_copy_that_fails_leaves_nothing_of_its_own(scans, tmp_path, monkeypatch):
    def full(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(creation.shutil, "copy2", full)
    with pytest.raises(InputError, match="cannot be written") as caught:
        create_project(tmp_path / "p", scans=[scans], copy=True)
    assert "No space" in caught.value.found
    assert not (tmp_path / "p").exists()
    put(tmp_path / "q" / "precious")
    with pytest.raises(InputError):
        create_project(tmp_path / "q", scans=[scans], copy=True)
    assert (tmp_path / "q" / "precious").exists()
    with pytest.raises(InputError, match="cannot be written"):
        create_project(put(tmp_path / "file"), scans=[scans])


def test_a_name_that_is_no_text_is_refused_plainly(scans, tmp_path):
    strange = tmp_path / "strange\udcff"
    try:
        scans.rename(strange)
    except (OSError, UnicodeEncodeError):
        pytest.skip("the file system allows only text")
    with pytest.raises(InputError, match="UTF-8") as caught:
        create_project(tmp_path / "p", scans=[strange])
    str(caught.value).encode()
    assert not (tmp_path / "p").exists()


@pytest.mark.parametrize("name", ['a"b', "a\\b", "a\nb", "ü雕", "tab\t", "a'b", "\x7f"])
def test_any_name_survives_the_project_file(tmp_path, name):
    put(tmp_path / name / "a.xyz", "0 0 0\n")
    project = create_project(tmp_path / f"{name}-p", scans=[tmp_path / name])
    assert project.name == f"{name}-p"
    assert project.file.inputs.scans == (f"../{name}",)
    assert len(project.input_paths("scan_files")) == 1


def test_options_reach_inside_groups_of_the_project_file(scans, tmp_path):
    project = create_project(tmp_path / "p", scans=[scans], preset="draft")
    toml = project.root / "project.toml"
    toml.write_text(
        toml.read_text() + "[stages.infill]\ndepth = 8\n[stages.fuse.window]\nrows = 1\n"
    )
    settings = Project(project.root).settings({"infill": {"point_weight": 2.0}})
    assert settings["infill"] == {"depth": 8, "point_weight": 2.0}
    assert settings["fuse"]["window"] == {"rows": 1}
    assert settings["fuse"]["thinning"] == 1.5  # from the preset


def test_a_project_that_is_none_is_told(tmp_path):
    for path in (tmp_path, tmp_path / "nowhere"):
        with pytest.raises(InputError, match="not a project") as caught:
            Project(path)
        assert "workbench new" in caught.value.fix
    put(tmp_path / "p" / "project.toml", "schema = 1\n")
    with pytest.raises(SettingsError, match="'name'"):
        Project(tmp_path / "p")
    put(tmp_path / "p" / "project.toml", "schema = 'new'\nname = 'x'\n")
    with pytest.raises(SettingsError, match="'schema'"):
        Project(tmp_path / "p")
