"""A page of the workbench in the browser, for the people at this machine alone.

It listens on 127.0.0.1 only, and answers only those who know the address with its random
token. Pages of other sites cannot reach it: ``Host`` must be its own address (no DNS
rebinding) and ``Origin``, where the browser tells one, too (RFC 6454). Nothing is read from
disk by a path out of a request: static files are held in memory under their names.
"""

from __future__ import annotations

import asyncio
import hmac
import json
import secrets
import socket
import threading
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from importlib import resources
from importlib.resources.abc import Traversable
from typing import Any

import tornado.web
from tornado.httpserver import HTTPServer
from tornado.netutil import bind_sockets

from workbench.errors import InputError, WorkbenchError

ADDRESS = "127.0.0.1"
LARGEST_BODY_BYTES = 64 * 2**20
SMALL_BODY_BYTES = 64 * 2**10
_LARGEST_HEAD_BYTES = 32 * 2**10
# A browser at this machine sends at once; whoever dribbles is let go.
_IDLE_S, _BODY_S = 120.0, 60.0
_TYPES = {
    ".html": "text/html; charset=utf-8",
    ".css": "text/css; charset=utf-8",
    ".js": "text/javascript; charset=utf-8",
    ".svg": "image/svg+xml",
}
_CONTENT_POLICY = "; ".join(
    (
        "default-src 'none'",
        "script-src 'self'",
        "style-src 'self'",
        "img-src 'self' blob:",
        "connect-src 'self'",
        "base-uri 'none'",
        "form-action 'none'",
        "frame-ancestors 'none'",
        "require-trusted-types-for 'script'",
        "trusted-types 'none'",
    )
)
_HEADERS = {
    "Content-Security-Policy": _CONTENT_POLICY,
    "Cross-Origin-Opener-Policy": "same-origin",
    "Cross-Origin-Resource-Policy": "same-origin",
    # The address holds the token, so it is told to nobody.
    "Referrer-Policy": "same-origin",
    "X-Content-Type-Options": "nosniff",
    "Cache-Control": "no-store",
}

Route = tuple[str, type["PageHandler"], dict[str, Any]]


@dataclass(frozen=True)
class StaticFile:
    """A file of a page, ready to send."""

    media_type: str
    content: bytes


def static_files(page: str) -> dict[str, StaticFile]:
    """The files of a page, from ``workbench/pages/static``, by name; ``""`` is its index."""
    folder: Traversable = resources.files("workbench.pages").joinpath("static", page)
    found = {
        entry.name: StaticFile(_TYPES["." + entry.name.rpartition(".")[2]], entry.read_bytes())
        for entry in folder.iterdir()
    }
    return found | {"": found["index.html"]}


class PageServer:
    """One page with what its scripts ask for; its port is taken at once.

    Parameters
    ----------
    files : static files by name.
    routes : pattern below the token, handler and its keyword arguments.
    ports : the first of them that is free is taken, 0 being any.

    Attributes
    ----------
    token : what the address must hold, 192 random bits.
    url : the address of the page.

    Raises
    ------
    InputError
        When none of the ports is free.
    """

    def __init__(
        self, files: Mapping[str, StaticFile], routes: Sequence[Route], ports: Sequence[int]
    ) -> None:
        self.token = secrets.token_urlsafe(24)
        self._sockets: dict[str, socket.socket] = {}
        self._http: HTTPServer | None = None
        self._loop: asyncio.AbstractEventLoop | None = None
        self._stopped = asyncio.Event()
        self._starting = threading.Lock()
        self._is_over = False
        shared: dict[str, Any] = {"server": self}
        patterns: list[Any] = [
            (f"/([^/]+)/{pattern}", handler, shared | arguments)
            for pattern, handler, arguments in routes
        ]
        patterns.append(("/([^/]+)/([^/]*)", _FileHandler, shared | {"files": files}))
        self._application = tornado.web.Application(
            patterns,
            default_handler_class=_NothingHere,
            default_handler_args=shared,
            # Requests name the token, which has no place in a log.
            log_function=lambda handler: None,
        )
        self.url = self._first_free(ports)

    def answers_to(self, authority: str) -> bool:
        """Whether ``host:port`` is one of the addresses listened on."""
        return authority in self._sockets

    def listen(self, port: int) -> str:
        """Listen on a port, 0 for any, beside those already open.

        Returns
        -------
        The address of the page there.

        Raises
        ------
        InputError
            When the port is taken or not allowed.
        """
        if not self.answers_to(f"{ADDRESS}:{port}"):
            try:
                (bound,) = bind_sockets(port, ADDRESS, socket.AF_INET)
            except (OSError, OverflowError) as error:
                raise InputError(
                    f"Port {port} cannot be used",
                    found=getattr(error, "strerror", None) or str(error),
                    fix="close what uses it, or name another with --port",
                ) from error
            port = bound.getsockname()[1]
            self._sockets[f"{ADDRESS}:{port}"] = bound
            if self._http is not None:
                self._http.add_socket(bound)
        return f"http://{ADDRESS}:{port}/{self.token}/"

    def serve(self) -> None:
        """Answer until the process is interrupted, or `stop` is called."""
        try:
            asyncio.run(self._answering())
        except KeyboardInterrupt:
            return

    def stop(self) -> None:
        """End `serve`, from whatever thread, and give the ports back."""
        with self._starting:
            self._is_over = True
            loop = self._loop
        if loop is None:
            self._close()
        else:
            with suppress(RuntimeError):  # it has ended already
                loop.call_soon_threadsafe(self._stopped.set)

    async def _answering(self) -> None:
        # Another thread may stop what is about to start.
        with self._starting:
            if self._is_over:
                return
            self._loop = asyncio.get_running_loop()
        self._http = HTTPServer(
            self._application,
            max_body_size=LARGEST_BODY_BYTES,
            max_buffer_size=2 * LARGEST_BODY_BYTES,
            max_header_size=_LARGEST_HEAD_BYTES,
            idle_connection_timeout=_IDLE_S,
            body_timeout=_BODY_S,
        )
        self._http.add_sockets(self._sockets.values())
        try:
            await self._stopped.wait()
        finally:
            self._http.stop()
            self._close()

    def _close(self) -> None:
        for bound in self._sockets.values():
            bound.close()

    def _first_free(self, ports: Sequence[int]) -> str:
        for port in ports[:-1]:
            try:
                return self.listen(port)
            except InputError:
                continue
        return self.listen(ports[-1])


@tornado.web.stream_request_body
class PageHandler(tornado.web.RequestHandler):
    """What every answer has in common: who may ask, and how errors are told.

    Who may not ask is turned away when the headers are there: nobody fills the memory with
    what comes after them.
    """

    server: PageServer
    largest_body_bytes = SMALL_BODY_BYTES

    def initialize(self, server: PageServer) -> None:
        self.server = server
        self._arrived = bytearray()

    @property
    def body(self) -> bytes:
        """What was sent after the headers."""
        return bytes(self._arrived)

    def data_received(self, chunk: bytes) -> None:
        """Keep a part of the body.

        Raises
        ------
        tornado.web.HTTPError
            413.
        """
        if len(self._arrived) + len(chunk) > self.largest_body_bytes:
            raise tornado.web.HTTPError(413)
        self._arrived += chunk

    def prepare(self) -> None:
        """Turn away whoever is not this page, or is about to send too much.

        Raises
        ------
        tornado.web.HTTPError
            403, 413.
        """
        host, origin = self.request.host, self.request.headers.get("Origin")
        # Of "OPTIONS *" and the like there is no second part.
        token = self.request.path.partition("/")[2].partition("/")[0]
        if (
            not self.server.answers_to(host)
            or origin not in (None, f"http://{host}")
            or not hmac.compare_digest(token.encode(), self.server.token.encode())
        ):
            raise tornado.web.HTTPError(403)
        announced = self.request.headers.get("Content-Length", "0")
        if not announced.isdecimal() or int(announced[:20]) > self.largest_body_bytes:
            raise tornado.web.HTTPError(413)

    def set_default_headers(self) -> None:
        self.clear_header("Server")
        for name, value in _HEADERS.items():
            self.set_header(name, value)

    def compute_etag(self) -> None:
        # Tornado would hash each body for a cache that is switched off.
        return None

    def give(self, content: bytes, media_type: str) -> None:
        """Answer with a body."""
        self.set_header("Content-Type", media_type)
        self.write(content)

    def give_json(self, value: Mapping[str, Any]) -> None:
        """Answer with one JSON object."""
        self.give(json.dumps(value).encode(), "application/json")

    def write_error(self, status_code: int, **kwargs: Any) -> None:
        """Errors of the workbench in the words that ``--json`` has for them."""
        error = kwargs.get("exc_info", (None, None, None))[1]
        if isinstance(error, WorkbenchError):
            self.set_status(422 if isinstance(error, InputError) else 500)
            self.give_json(error.as_dict())
            return
        said = {
            403: "Only the page at the address that workbench printed may ask this",
            404: "There is nothing at this address",
            413: "This is more than the page would ever send",
        }
        self.give_json({"message": said.get(status_code, self._reason)})

    def log_exception(self, typ: Any, value: BaseException | None, tb: Any) -> None:
        # What the user did is told to the user; the rest is ours.
        if not isinstance(value, (InputError, tornado.web.HTTPError)):
            super().log_exception(typ, value, tb)


class _FileHandler(PageHandler):
    """The page itself: HTML, style, scripts."""

    files: Mapping[str, StaticFile]

    def initialize(self, server: PageServer, files: Mapping[str, StaticFile]) -> None:  # type: ignore[override]
        super().initialize(server)
        self.files = files

    def get(self, token: str, name: str) -> None:
        file = self.files.get(name)
        if file is None:
            raise tornado.web.HTTPError(404)
        self.give(file.content, file.media_type)


class _NothingHere(PageHandler):
    """Every other address."""

    def prepare(self) -> None:
        super().prepare()
        raise tornado.web.HTTPError(404)
