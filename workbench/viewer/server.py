"""A site shown to the people at this machine alone, file by file and part by part.

As `workbench.pages.server` does, it listens on 127.0.0.1 and answers only those who know the
address. What may be asked for is listed when it starts: no path out of a request reaches the
disk. Parts of files are handed out as RFC 9110, section 14, describes, one range at a time.
"""

from __future__ import annotations

import hashlib
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import tornado.web

from workbench.pages.server import PageHandler, PageServer
from workbench.viewer.site import Site

_TYPES = {
    ".html": "text/html; charset=utf-8",
    ".css": "text/css; charset=utf-8",
    ".js": "text/javascript; charset=utf-8",
    ".json": "application/json",
    ".svg": "image/svg+xml",
    ".glb": "model/gltf-binary",
    ".jpg": "image/jpeg",
    ".png": "image/png",
}
_FIRST_PORT, _PORTS = 30_000, 10_000
_PIECE_BYTES = 1 << 20


def site_server(site: Site, port: int = 0) -> PageServer:
    """A server of a site; ``serve`` of what is returned runs it.

    Parameters
    ----------
    site : as `build_site` made it.
    port : to listen on; 0 for the site's own, or any where that is taken.

    Raises
    ------
    InputError
        The port is taken.
    """
    files = {
        path.relative_to(site.folder).as_posix(): path
        for path in site.folder.rglob("*")
        if _is_own(path, site.folder) and path.name != "made.json"
    }
    name = hashlib.sha256(str(site.folder).encode()).hexdigest()
    own = _FIRST_PORT + int(name[:8], 16) % _PORTS
    listed = files | {"": files["index.html"]}
    routes = [("(.*)", _SiteHandler, {"listed": listed, "folder": site.folder})]
    return PageServer({}, routes, [port] if port else [own, 0])


def _is_own(path: Path, folder: Path) -> bool:
    """Whether a path is a file inside a folder, not one that a link leads to elsewhere."""
    return path.is_file() and path.resolve().is_relative_to(folder.resolve())


class _SiteHandler(PageHandler):
    """Files of the site, whole or in part."""

    listed: Mapping[str, Path]
    folder: Path

    def initialize(  # type: ignore[override]
        self, server: PageServer, listed: Mapping[str, Path], folder: Path
    ) -> None:
        super().initialize(server)
        self.listed, self.folder = listed, folder

    async def get(self, token: str, name: str) -> None:
        """Answer with a file."""
        await self._answer(name, send=True)

    async def head(self, token: str, name: str) -> None:
        """Answer with what a file is like."""
        await self._answer(name, send=False)

    async def _answer(self, name: str, *, send: bool) -> None:
        path = self.listed.get(name)
        if path is None or not _is_own(path, self.folder):
            raise tornado.web.HTTPError(404)
        size = path.stat().st_size
        first, last = self._range(size)
        self.set_header("Content-Type", _TYPES.get(path.suffix, "application/octet-stream"))
        self.set_header("Accept-Ranges", "bytes")
        self.set_header("Content-Length", str(last - first + 1))
        if not send:
            return
        with open(path, "rb") as file:
            file.seek(first)
            left = last - first + 1
            while left > 0:
                piece = file.read(min(left, _PIECE_BYTES))
                if not piece:
                    break
                self.write(piece)
                await self.flush()
                left -= len(piece)

    def _range(self, size: int) -> tuple[int, int]:
        """First and last byte asked for; a range that is not understood asks for all."""
        asked = re.fullmatch(r"bytes=(\d*)-(\d*)", self.request.headers.get("Range", ""))
        if not asked or not (asked[1] or asked[2]):
            return 0, size - 1
        first = int(asked[1]) if asked[1] else max(size - int(asked[2]), 0)
        last = min(int(asked[2]), size - 1) if asked[1] and asked[2] else size - 1
        if first > last:
            raise _BeyondTheEndError(size)
        self.set_status(206)
        self.set_header("Content-Range", f"bytes {first}-{last}/{size}")
        return first, last

    def write_error(self, status_code: int, **kwargs: Any) -> None:
        """As other pages do; of a part that is not there, how long the file is."""
        error = kwargs.get("exc_info", (None, None, None))[1]
        if isinstance(error, _BeyondTheEndError):
            self.set_header("Content-Range", f"bytes */{error.size}")
        super().write_error(status_code, **kwargs)


class _BeyondTheEndError(tornado.web.HTTPError):
    """A part was asked for that begins after the end of a file of so many bytes."""

    def __init__(self, size: int) -> None:
        super().__init__(416)
        self.size = size
