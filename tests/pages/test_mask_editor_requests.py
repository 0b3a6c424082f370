"""The mask editor as whoever can reach its port sees it."""

from __future__ import annotations

import gzip
import http.client
import json
import os
import threading
import zlib
from dataclasses import replace
from pathlib import Path

import numpy as np
import psutil
import pytest
from filelock import FileLock
from PIL import Image

from workbench.errors import InputError
from workbench.masking.rectangle import RECTANGLE_DEFAULTS, segmented_in_rectangle
from workbench.pages import mask_pictures
from workbench.pages import server as server_module
from workbench.pages.mask_editor import home_port, mask_editor_server
from workbench.project import user_masks
from workbench.project.project import Project

from .conftest import HEIGHT, WIDTH, object_mask

PUT = {"Content-Type": "application/gzip"}


@pytest.fixture
def ask(server):
    """A function that sends one request as told and gives status, headers and body."""
    authority, token = server.url.split("/")[2:4]

    def send(method, path, body=None, headers=None, *, token=token, host=authority):
        connection = http.client.HTTPConnection(authority, timeout=30)
        connection.putrequest(method, f"/{token}/{path}", skip_host=True)
        sent = {"Host": host, "Content-Length": str(len(body or b""))} | (headers or {})
        for name, value in sent.items():
            connection.putheader(name, value)
        connection.endheaders(body)
        answer = connection.getresponse()
        return answer.status, answer.headers, answer.read()

    return send


@pytest.fixture
def put(ask):
    """A function that saves a mask; without a version, over what is there."""

    def save(mask, role="training", name="a", version=None):
        version = version or state(ask, name)["version"]
        body = gzip.compress(np.ascontiguousarray(mask, np.uint8).tobytes())
        path = f"api/photo/{name}/mask?role={role}"
        status, _, answer = ask("PUT", path, body, PUT | {"If-Match": version})
        return status, json.loads(answer)

    return save


def state(ask, name="a"):
    return json.loads(ask("GET", f"api/photo/{name}/mask")[1]["Mask-State"])


def some_mask(seed=0):
    return (np.random.default_rng(seed).random((HEIGHT, WIDTH)) < 0.5).astype(np.uint8) * 255


@pytest.mark.parametrize("path", ["", "main.js", "api/project", "api/photo/a/picture", "nothing"])
@pytest.mark.parametrize("token", ["", "x", "x" * 32, "%00", "\u00e9".encode().hex()])
def test_nothing_is_answered_without_the_token(ask, path, token):
    status, _, body = ask("GET", path, token=token)
    assert status == 403
    assert b"token" not in body


def test_a_mask_cannot_be_written_without_the_token(ask, drawn):
    body = gzip.compress(some_mask().tobytes())
    version = {"If-Match": state(ask)["version"]}
    path = "api/photo/a/mask?role=training"
    assert ask("PUT", path, body, version, token="guess")[0] == 403
    assert drawn("training") is None


@pytest.mark.parametrize("host", ["evil.example", "localhost", "127.0.0.1:1", "", "[::1]"])
def test_another_host_is_refused(ask, host):
    assert ask("GET", "api/project", host=host)[0] == 403


@pytest.mark.parametrize("origin", ["http://evil.example", "null", "http://localhost", "file://"])
def test_another_origin_is_refused(ask, origin):
    for method, path in (("GET", "api/project"), ("POST", "api/photo/a/rectangle")):
        assert ask(method, path, headers={"Origin": origin})[0] == 403


def test_its_own_origin_is_answered(ask, server):
    origin = server.url.rsplit("/", 2)[0]
    assert ask("GET", "api/project", headers={"Origin": origin})[0] == 200


@pytest.mark.parametrize(
    "path",
    [
        "../../etc/passwd",
        "..%2f..%2f..%2fetc%2fpasswd",
        "%2e%2e/index.html",
        "static/main.js",
        "api/photo/..%2f..%2fproject/mask",
        "api/photo/..%2fa/thumbnail",
        "api/scan/a/mask",
        "main.js/",
        "conftest.py",
    ],
)
def test_nothing_else_on_disk_is_reachable(ask, path):
    status, _, body = ask("GET", path)
    assert status in (403, 404)
    assert b"root:" not in body


def test_files_have_their_types_and_a_strict_policy(ask):
    for name, kind in {
        "": "text/html",
        "main.js": "text/javascript",
        "style.css": "text/css",
    }.items():
        status, headers, _ = ask("GET", name)
        assert status == 200
        assert headers["Content-Type"].startswith(kind)
        policy = headers["Content-Security-Policy"]
        assert policy.startswith("default-src 'none'")
        assert "unsafe" not in policy
        assert "http" not in policy
        assert headers["X-Content-Type-Options"] == "nosniff"


def test_it_listens_on_loopback_only(server, ask):
    ask("GET", "")
    port = int(server.url.split(":")[2].split("/")[0])
    mine = psutil.Process(os.getpid()).net_connections(kind="inet")
    listening = {c.laddr.ip for c in mine if c.laddr.port == port and c.status == "LISTEN"}
    assert listening == {"127.0.0.1"}


def test_tokens_are_long_and_never_the_same(project):
    servers = [mask_editor_server(project) for _ in range(8)]
    tokens = {server.token for server in servers}
    for server in servers:
        server.stop()
    assert len(tokens) == 8
    assert min(map(len, tokens)) >= 32


def test_a_saved_mask_is_the_mask_on_disk(ask, put, drawn):
    mask = some_mask()
    status, told = put(mask, "training")
    assert (status, told["standing"]) == (200, "training")
    np.testing.assert_array_equal(drawn("training"), mask > 0)
    _, headers, body = ask("GET", "api/photo/a/mask")
    assert json.loads(headers["Mask-State"]) == told
    np.testing.assert_array_equal(np.frombuffer(gzip.decompress(body), np.uint8), mask.ravel())


@pytest.mark.parametrize("pixels", [WIDTH * HEIGHT - 1, WIDTH * HEIGHT + 1, 0, 10 * WIDTH * HEIGHT])
def test_a_mask_of_another_size_is_refused(ask, drawn, pixels):
    headers = {"If-Match": state(ask)["version"]}
    body = gzip.compress(bytes(pixels))
    status, _, answer = ask("PUT", "api/photo/a/mask?role=training", body, headers)
    assert status == 422
    assert f"{WIDTH} × {HEIGHT}" in json.loads(answer)["expected"]
    assert drawn("training") is None


@pytest.mark.parametrize("damage", ["cut", "not gzip", "empty"])
def test_a_mask_that_did_not_arrive_whole_is_refused(ask, drawn, damage):
    whole = gzip.compress(some_mask().tobytes())
    body = {"cut": whole[:-9], "not gzip": b"P5 240 180", "empty": b""}[damage]
    headers = {"If-Match": state(ask)["version"]}
    assert ask("PUT", "api/photo/a/mask?role=training", body, headers)[0] == 422
    assert drawn("training") is None


def test_a_body_that_unpacks_to_gigabytes_costs_no_memory(ask):
    packer = zlib.compressobj(9, wbits=31)
    start = packer.compress(bytes(2**24)) + packer.flush(zlib.Z_FULL_FLUSH)
    again = packer.compress(bytes(2**24)) + packer.flush(zlib.Z_FULL_FLUSH)
    bomb = start + 256 * again
    assert len(bomb) < server_module.LARGEST_BODY_BYTES
    before = psutil.Process().memory_info().rss
    headers = {"If-Match": state(ask)["version"]}
    assert ask("PUT", "api/photo/a/mask?role=training", bomb, headers)[0] == 422
    assert psutil.Process().memory_info().rss - before < 2**28


def test_a_body_over_the_limit_is_not_read(ask, drawn):
    headers = {
        "If-Match": state(ask)["version"],
        "Content-Length": str(server_module.LARGEST_BODY_BYTES + 1),
    }
    status = ask("PUT", "api/photo/a/mask?role=training", b"", headers)[0]
    assert status in (400, 413)
    assert drawn("training") is None


def test_a_write_that_fails_leaves_the_old_mask(ask, put, drawn, project, monkeypatch):
    put(some_mask(1), "training")

    def full_disk(path, mask):
        path.write_bytes(b"half")
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(user_masks, "write_mask_png", full_disk)
    status, told = put(some_mask(2), "training")
    assert status == 422
    assert told["found"] == "No space left on device"
    np.testing.assert_array_equal(drawn("training"), some_mask(1) > 0)
    assert [p.name for p in (project.root / "masks" / "training").iterdir()] == ["a.png"]


def test_a_mask_changed_meanwhile_is_not_overwritten(ask, put, drawn, project):
    seen = put(some_mask(1), "training")[1]["version"]
    elsewhere = project.root / "masks" / "training" / "a.png"
    Image.fromarray(some_mask(2)).save(elsewhere)
    status, told = put(some_mask(3), "training", version=seen)
    assert status == 412
    np.testing.assert_array_equal(drawn("training"), some_mask(2) > 0)
    assert put(some_mask(3), "training", version=told["state"]["version"])[0] == 200
    np.testing.assert_array_equal(drawn("training"), some_mask(3) > 0)


def test_of_many_at_once_one_wins_and_the_others_are_told(ask, put):
    seen = state(ask)["version"]
    statuses = []
    threads = [
        threading.Thread(target=lambda k=k: statuses.append(put(some_mask(k), version=seen)[0]))
        for k in range(8)
    ]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert sorted(statuses) == [200, *7 * [412]]


def test_another_editor_of_the_project_is_waited_for(put, ask, drawn, project):
    seen = state(ask)["version"]
    folder = project.root / "masks" / "training"
    folder.mkdir(parents=True)
    statuses = []
    late = threading.Thread(target=lambda: statuses.append(put(some_mask(1), version=seen)[0]))
    with FileLock(project.root / "masks" / ".lock"):
        late.start()
        late.join(1.5)
        assert late.is_alive()
        Image.fromarray(some_mask(2)).save(folder / "a.png")
    late.join()
    assert statuses == [412]
    np.testing.assert_array_equal(drawn("training"), some_mask(2) > 0)


def test_a_change_without_a_version_is_refused(ask, drawn):
    body = gzip.compress(some_mask().tobytes())
    assert ask("PUT", "api/photo/a/mask?role=training", body)[0] == 428
    assert ask("DELETE", "api/photo/a/mask")[0] == 428
    assert drawn("training") is None


@pytest.mark.parametrize("role", ["", "automatic", "../x"])
def test_only_the_two_roles_can_be_written(ask, role):
    headers = {"If-Match": state(ask)["version"]}
    body = gzip.compress(some_mask().tobytes())
    assert ask("PUT", f"api/photo/a/mask?role={role}", body, headers)[0] == 400


def test_a_mask_moves_to_its_new_role(put, drawn):
    put(some_mask(1), "training")
    assert put(some_mask(1), "corrected")[1]["standing"] == "corrected"
    assert drawn("training") is None
    np.testing.assert_array_equal(drawn("corrected"), some_mask(1) > 0)


def test_a_training_mask_beside_a_correction_stays(put, drawn, project):
    put(some_mask(1), "corrected")
    beside = project.root / "masks" / "training"
    beside.mkdir()
    Image.fromarray(some_mask(2)).save(beside / "a.png")
    assert put(some_mask(3), "corrected")[1]["both"]
    np.testing.assert_array_equal(drawn("training"), some_mask(2) > 0)
    np.testing.assert_array_equal(drawn("corrected"), some_mask(3) > 0)
    assert put(some_mask(4), "training")[1]["standing"] == "corrected"
    np.testing.assert_array_equal(drawn("training"), some_mask(4) > 0)
    np.testing.assert_array_equal(drawn("corrected"), some_mask(3) > 0)


def test_without_a_correction_the_automatic_mask_stands(ask, put, project):
    project.store.save("automatic_photo_masks", some_mask(4), "a")
    assert state(ask)["standing"] == "automatic"
    told = put(some_mask(5), "corrected")[1]
    assert (told["standing"], told["automatic"]) == ("corrected", True)
    status, _, body = ask("DELETE", "api/photo/a/mask", headers={"If-Match": told["version"]})
    assert (status, json.loads(body)["standing"]) == (200, "automatic")
    shown = np.frombuffer(gzip.decompress(ask("GET", "api/photo/a/mask")[2]), np.uint8)
    np.testing.assert_array_equal(shown, some_mask(4).ravel())


def test_files_that_belong_to_nothing_are_told_and_hide_nothing(ask, put, project):
    put(some_mask(), "training", "b")
    folder = project.root / "masks" / "training"
    Image.fromarray(some_mask()).save(folder / "nobody.png")
    (folder / "notes.txt").write_text("x")
    told = json.loads(ask("GET", "api/project")[2])
    standings = {subject["name"]: subject["standing"] for subject in told["subjects"]}
    assert standings == {"a": "none", "b": "training", "c": "none"}
    strays = [Path(problem["file"]).name for problem in told["problems"]]
    assert strays == ["nobody.png", "notes.txt"]


def test_a_damaged_mask_is_told_and_can_be_drawn_over(ask, put, drawn, project):
    put(some_mask(), "training")
    (project.root / "masks" / "training" / "a.png").write_bytes(b"\x89PNG nothing")
    status, headers, body = ask("GET", "api/photo/a/mask")
    assert status == 422
    assert json.loads(body)["message"] == "The mask cannot be read"
    version = json.loads(headers["Mask-State"])["version"]
    assert put(some_mask(2), "training", version=version)[0] == 200
    np.testing.assert_array_equal(drawn("training"), some_mask(2) > 0)


def test_scans_have_masks_of_their_grid_and_none_without(project, put, ask):
    entry = {"name": "s", "file": "s.ply", "grid": [3, 5]}
    project.store.save("scan_inventory", {"scans": [entry, entry | {"name": "t", "grid": None}]})
    told = json.loads(ask("GET", "api/project")[2])
    assert [(s["name"], s["size"]) for s in told["subjects"][:2]] == [("s", [5, 3]), ("t", None)]
    assert len(gzip.decompress(ask("GET", "api/scan/s/mask")[2])) == 15
    status, _, body = ask("GET", "api/scan/t/mask")
    assert status == 422
    assert "no grid" in json.loads(body)["message"]


def test_the_object_is_found_in_the_rectangle_and_nowhere_else(ask, project):
    left, top, right, bottom = rectangle = (50, 35, 190, 145)
    body = json.dumps({"rectangle": rectangle}).encode()
    found = gzip.decompress(ask("POST", "api/photo/a/rectangle", body)[2])
    found = np.frombuffer(found, np.uint8).reshape(bottom - top, right - left)
    image = np.asarray(Image.open(project.photo_files[0]))
    options = replace(RECTANGLE_DEFAULTS, erosion_px=0)
    whole = segmented_in_rectangle(image, rectangle, options)
    np.testing.assert_array_equal(found, whole[top:bottom, left:right])
    truth = object_mask()[top:bottom, left:right]
    assert ((found > 0) & truth).sum() / ((found > 0) | truth).sum() > 0.97


@pytest.mark.parametrize(
    ("body", "status"),
    [
        ({"rectangle": [0, 0, WIDTH, HEIGHT]}, 422),
        ({"rectangle": [9, 9, 9, 20]}, 422),
        ({"rectangle": [-5, 0, 20, 20]}, 422),
        ({"rectangle": [0, 0, 20]}, 400),
        ({"rectangle": "0123"}, 400),
        ({}, 400),
        ([], 400),
    ],
)
def test_a_rectangle_that_makes_no_sense_is_refused(ask, body, status):
    assert ask("POST", "api/photo/a/rectangle", json.dumps(body).encode())[0] == status


def test_a_large_picture_is_shown_smaller_and_its_mask_is_not(ask, monkeypatch, tmp_path):
    monkeypatch.setattr(mask_pictures, "LONGEST_SIDE_PX", 100)
    (tmp_path / "shown.jpg").write_bytes(ask("GET", "api/photo/a/picture")[2])
    assert Image.open(tmp_path / "shown.jpg").size == (100, 75)
    assert len(gzip.decompress(ask("GET", "api/photo/a/mask")[2])) == WIDTH * HEIGHT


def test_the_picture_is_the_photograph(ask, project, tmp_path):
    (tmp_path / "shown.jpg").write_bytes(ask("GET", "api/photo/b/picture")[2])
    shown = np.asarray(Image.open(tmp_path / "shown.jpg"), float)
    photo = np.asarray(Image.open(project.photo_files[1]), float)
    assert np.abs(shown - photo).mean() < 6


def test_a_project_keeps_its_port_and_yields_where_it_is_taken(project):
    servers = [mask_editor_server(project) for _ in range(2)]
    ports = [int(server.url.split(":")[2].split("/")[0]) for server in servers]
    assert ports[0] == home_port(project) == home_port(Project(project.root))
    assert ports[1] != ports[0]
    with pytest.raises(InputError, match=f"Port {ports[0]} cannot be used"):
        mask_editor_server(project, ports[0])
    for server in servers:
        server.stop()
    again = mask_editor_server(project, ports[0])
    again.stop()


def test_an_earlier_port_is_opened_on_request(ask, server):
    wanted = int(server.url.split(":")[2].split("/")[0]) - 11_000
    assert ask("GET", "api/project", host=f"127.0.0.1:{wanted}")[0] == 403
    status, _, body = ask("POST", "api/port", json.dumps({"port": wanted}).encode())
    assert (status, json.loads(body)["url"]) == (200, f"http://127.0.0.1:{wanted}/{server.token}/")
    connection = http.client.HTTPConnection("127.0.0.1", wanted, timeout=30)
    connection.request("GET", f"/{server.token}/api/project")
    assert connection.getresponse().status == 200
    for port in (80, 70_000, "22", None):
        assert ask("POST", "api/port", json.dumps({"port": port}).encode())[0] == 400
