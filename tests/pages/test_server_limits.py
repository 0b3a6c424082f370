"""Clients that mean no good, or are slow: what they cost, and what the others notice."""

from __future__ import annotations

import json
import re
import socket
import threading
import time
from collections.abc import Iterator
from contextlib import closing

import pytest

from workbench.pages import server as server_module
from workbench.pages.mask_editor import mask_editor_server
from workbench.pages.server import LARGEST_BODY_BYTES, SMALL_BODY_BYTES

from .conftest import HEIGHT, WIDTH

SOON_S = 10.0


def connected(server) -> socket.socket:
    host, port = server.url.split("/")[2].split(":")
    return socket.create_connection((host, int(port)), timeout=SOON_S)


def head(server, line: str, **headers: str) -> bytes:
    """A request up to its body; ``TOKEN`` in the line is the server's."""
    lines = [line.replace("TOKEN", server.token), f"Host: {server.url.split('/')[2]}"]
    lines += [f"{name.replace('_', '-')}: {value}" for name, value in headers.items()]
    return ("\r\n".join(lines) + "\r\n\r\n").encode()


def status_of(answer: bytes) -> int | None:
    found = re.match(rb"HTTP/1.1 (\d+)", answer)
    return int(found[1]) if found else None


def answered(server, sent: bytes) -> int | None:
    """The status of the answer to some bytes; None where the connection is closed instead."""
    with closing(connected(server)) as client:
        try:
            client.sendall(sent)
            return status_of(client.recv(4096))
        except (ConnectionResetError, BrokenPipeError):
            return None


def is_well(server) -> bool:
    """Whether others are answered, and soon."""
    start = time.monotonic()
    status = answered(server, head(server, "GET /TOKEN/api/project HTTP/1.1"))
    return status == 200 and time.monotonic() - start < SOON_S / 2


@pytest.mark.parametrize(
    ("line", "headers", "status"),
    [
        ("PUT /guess/api/photo/a/mask?role=training HTTP/1.1", {}, 403),
        ("PUT /TOKEN/api/photo/a/mask?role=training HTTP/1.1", {"Origin": "http://evil"}, 403),
        ("POST /guess/ HTTP/1.1", {}, 403),
        ("POST /TOKEN/api/photo/a/rectangle HTTP/1.1", {}, 413),
        ("GET /TOKEN/main.js HTTP/1.1", {}, 413),
    ],
)
def test_strangers_are_turned_away_before_they_send_a_body(server, line, headers, status):
    sent = head(server, line, Content_Length=str(LARGEST_BODY_BYTES), **headers)
    # Nothing follows: who waits for the body first does not answer.
    assert answered(server, sent) == status
    assert is_well(server)


@pytest.mark.parametrize("size", ["-1", "1e3", "0x10", "9" * 400, "1, 2", "²"])
def test_an_announced_size_that_is_none_is_refused(server, size):
    sent = head(server, "POST /TOKEN/api/port HTTP/1.1", Content_Length=size)
    assert answered(server, sent) in (400, 413, None)
    assert is_well(server)


def test_parts_without_an_announced_size_are_counted(server):
    line = "POST /TOKEN/api/photo/a/rectangle HTTP/1.1"
    part = b"%x\r\n%b\r\n" % (SMALL_BODY_BYTES // 2, b"x" * (SMALL_BODY_BYTES // 2))
    sent = head(server, line, Transfer_Encoding="chunked") + 3 * part + b"0\r\n\r\n"
    assert answered(server, sent) in (413, None)
    sent = head(server, line, Transfer_Encoding="chunked") + part + b"0\r\n\r\n"
    assert answered(server, sent) == 400
    assert is_well(server)


@pytest.mark.parametrize(
    "sent",
    [
        b"GET /" + b"a" * 200_000 + b" HTTP/1.1\r\n\r\n",
        b"GET / HTTP/1.1\r\n" + b"A: b\r\n" * 50_000 + b"\r\n",
        b"GET / HTTP/1.1\r\nA: " + b"b" * 200_000 + b"\r\n\r\n",
    ],
)
def test_long_requests_are_cut_off(server, sent):
    assert answered(server, sent) in (400, 431, None)
    assert is_well(server)


@pytest.mark.parametrize(
    "line",
    ["OPTIONS * HTTP/1.1", "GET TOKEN HTTP/1.1", "CONNECT a:1 HTTP/1.1", "GET // HTTP/1.1",
     "GET /%ff%fe/ HTTP/1.1", "GET http://evil.example/TOKEN/ HTTP/1.1", "GET /?TOKEN HTTP/1.1"],
)  # fmt: skip
def test_odd_addresses_are_refused_and_are_no_fault_of_ours(server, line):
    assert answered(server, head(server, line)) in (400, 403, 404, 405)
    assert is_well(server)


@pytest.mark.parametrize("sent", [b"\0" * 4000, b"\x16\x03\x01\x02\x00\x01", b"\r\n\r\n", b"HELO"])
def test_other_protocols_do_no_harm(server, sent):
    with closing(connected(server)) as client:
        client.sendall(sent)
        assert is_well(server)


def test_a_second_host_does_not_help(server):
    sent = head(server, "GET /TOKEN/ HTTP/1.1", Host="evil.example")
    assert answered(server, sent) in (400, 403)


def test_deeply_nested_json_is_a_bad_request(server):
    body = b"[" * 20_000
    line = "POST /TOKEN/api/port HTTP/1.1"
    assert answered(server, head(server, line, Content_Length=str(len(body))) + body) == 400


def test_slow_clients_keep_nobody_waiting(server):
    upload = head(
        server,
        "PUT /TOKEN/api/photo/a/mask?role=training HTTP/1.1",
        Content_Length=str(WIDTH * HEIGHT),
        If_Match="x",
    )
    clients = [connected(server) for _ in range(60)]
    try:
        for k, client in enumerate(clients):
            client.sendall((upload + b"\x1f\x8b")[: len(upload) + 2 if k % 2 else 40])
        assert is_well(server)
    finally:
        for client in clients:
            client.close()
    assert is_well(server)


@pytest.fixture
def impatient(project, monkeypatch) -> Iterator[object]:
    """The mask editor with little patience."""
    monkeypatch.setattr(server_module, "_IDLE_S", 0.5)
    monkeypatch.setattr(server_module, "_BODY_S", 0.5)
    server = mask_editor_server(project)
    thread = threading.Thread(target=server.serve)
    thread.start()
    yield server
    server.stop()
    thread.join()


def test_it_ends_whenever_it_is_stopped(project):
    for turn in range(60):
        server = mask_editor_server(project)
        thread = threading.Thread(target=server.serve, daemon=True)
        if turn % 3:
            thread.start()
        if turn % 3 == 2:
            time.sleep(1e-4 * turn)
        server.stop()
        if not turn % 3:
            thread.start()
        thread.join(20.0)
        assert not thread.is_alive()
        server.stop()
        with pytest.raises(ConnectionRefusedError):
            connected(server)


@pytest.mark.parametrize("part", ["nothing", "headers", "body"])
def test_who_stops_sending_is_let_go(impatient, part):
    line = "PUT /TOKEN/api/photo/a/mask?role=training HTTP/1.1"
    whole = head(impatient, line, Content_Length="1000", If_Match="x") + b"\x1f\x8b"
    sent = {"nothing": b"", "headers": whole[:30], "body": whole}[part]
    with closing(connected(impatient)) as client:
        client.sendall(sent)
        assert client.recv(4096) == b""
    assert is_well(impatient)


@pytest.mark.parametrize("entry", [{"name": "../../stolen"}, {"file": "/etc/x"}, {"grid": "no"}])
def test_scans_that_are_called_like_other_places_are_refused(server, project, entry):
    sound = {"name": "s", "file": "s.ply", "grid": [3, 5]}
    project.store.save("scan_inventory", {"scans": [sound | entry]})
    assert answered(server, head(server, "GET /TOKEN/api/project HTTP/1.1")) == 422


def test_a_link_takes_no_mask_out_of_the_project(server, project, tmp_path):
    import gzip

    elsewhere = tmp_path / "elsewhere"
    elsewhere.mkdir()
    (project.root / "masks").mkdir()
    (project.root / "masks" / "training").symlink_to(elsewhere)
    with closing(connected(server)) as client:
        client.sendall(head(server, "GET /TOKEN/api/photo/a/mask HTTP/1.1"))
        told = re.search(rb"Mask-State: (.*)\r\n", client.recv(65536))
    assert told is not None
    body = gzip.compress(bytes(WIDTH * HEIGHT))
    line = "PUT /TOKEN/api/photo/a/mask?role=training HTTP/1.1"
    sent = head(
        server, line, Content_Length=str(len(body)), If_Match=json.loads(told[1])["version"]
    )
    assert answered(server, sent + body) == 422
    assert not list(elsewhere.iterdir())
