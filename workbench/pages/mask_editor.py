"""The page ``workbench edit-masks``: drawing and correcting masks.

Masks travel as gzip of one byte a pixel, 0 or 255, row by row at the subject's full size,
whatever size the picture is shown at. Every change names the version it was made to in
``If-Match`` and is refused with 412 where the files have changed since (RFC 9110, 13.1.1).
"""

from __future__ import annotations

import asyncio
import gzip
import hashlib
import json
import zlib
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from typing import Any, ParamSpec, TypeVar, get_args

import numpy as np
import tornado.web
from numpy.typing import NDArray

from workbench.errors import InputError
from workbench.pages.mask_files import MaskChangedError, MaskFiles, MaskState
from workbench.pages.mask_pictures import MaskPictures
from workbench.pages.server import LARGEST_BODY_BYTES, PageHandler, PageServer, static_files
from workbench.project.mask_subjects import mask_subjects
from workbench.project.project import Project
from workbench.project.user_masks import Role, Subject

P = ParamSpec("P")
T = TypeVar("T")

_FIRST_PORT, _PORTS = 20_000, 10_000
_SUBJECT = "(scan|photo)/([^/]+)"


def mask_editor_server(project: Project, port: int = 0) -> PageServer:
    """The mask editor of a project; ``serve`` of what is returned runs it.

    Parameters
    ----------
    port : to listen on; 0 for the project's own, or any where that is taken. A browser keeps
        unsaved drawings per port, so that a project is best served at one and the same.

    Raises
    ------
    InputError
        When the port is taken, or the project's photographs cannot be read.
    """
    desk = _Desk(project)
    routes = [
        ("api/project", _ProjectHandler),
        ("api/port", _PortHandler),
        (f"api/{_SUBJECT}/mask", _MaskHandler),
        (f"api/{_SUBJECT}/picture", _PictureHandler),
        (f"api/{_SUBJECT}/thumbnail", _ThumbnailHandler),
        (f"api/{_SUBJECT}/rectangle", _RectangleHandler),
    ]
    return PageServer(
        static_files("mask_editor"),
        [(pattern, handler, {"desk": desk}) for pattern, handler in routes],
        [port] if port else [home_port(project), 0],
    )


def project_identity(project: Project) -> str:
    """What tells a project from others on this machine: a hash of where it lies."""
    return hashlib.sha256(str(project.root).encode()).hexdigest()[:16]


def home_port(project: Project) -> int:
    """The port a project's page is served at where it is free, always the same."""
    return _FIRST_PORT + int(project_identity(project), 16) % _PORTS


class _Desk:
    """What the handlers of one page share: the project, its masks, its pictures."""

    def __init__(self, project: Project) -> None:
        # One thread each: a mask is saved at once while a RAW file is being developed, and the
        # small pictures of the list keep nobody waiting.
        self.masking = ThreadPoolExecutor(1, "masks")
        self.drawing = ThreadPoolExecutor(1, "pictures")
        self.listing = ThreadPoolExecutor(1, "thumbnails")
        self.open(project)

    def open(self, project: Project) -> None:
        """Look at the project's files anew."""
        self.project = project
        self.files = MaskFiles(project, mask_subjects(project))
        self.pictures = MaskPictures(project)

    def subject(self, kind: str, name: str) -> Subject:
        """The subject of a request.

        Raises
        ------
        tornado.web.HTTPError
            404.
        """
        for subject in self.files.subjects:
            if (subject.kind, subject.name) == (kind, name):
                return subject
        raise tornado.web.HTTPError(404)


class _DeskHandler(PageHandler):
    """An answer about the project."""

    desk: _Desk

    def initialize(self, server: PageServer, desk: _Desk) -> None:  # type: ignore[override]
        super().initialize(server)
        self.desk = desk

    async def in_thread(
        self,
        thread: ThreadPoolExecutor,
        function: Callable[P, T],
        *args: P.args,
        **kwargs: P.kwargs,
    ) -> T:
        """What a function returns, without keeping other requests waiting."""
        loop = asyncio.get_running_loop()
        return await loop.run_in_executor(thread, lambda: function(*args, **kwargs))


class _ProjectHandler(_DeskHandler):
    async def get(self, token: str) -> None:
        self.give_json(await self.in_thread(self.desk.masking, self._project))

    def _project(self) -> dict[str, Any]:
        self.desk.open(Project(self.desk.project.root))
        project, files = self.desk.project, self.desk.files
        standings = files.standings()
        listed = project.store.exists("scan_inventory")
        return {
            "name": project.name,
            "root": str(project.root),
            "identity": project_identity(project),
            "scans_unknown": bool(project.file.inputs.scans) and not listed,
            "problems": [problem.as_dict() for problem in files.problems()],
            "subjects": [
                {
                    "kind": subject.kind,
                    "name": subject.name,
                    "file": subject.file,
                    "size": subject.size,
                    "standing": standings[subject],
                }
                for subject in files.subjects
            ],
        }


class _PortHandler(_DeskHandler):
    """Opens a port the page was at before, where the browser kept unsaved drawings."""

    def post(self, token: str) -> None:
        port = _field(self.body, "port")
        if not isinstance(port, int) or not 1024 <= port < 65536:
            raise tornado.web.HTTPError(400)
        self.give_json({"url": self.server.listen(port)})


class _MaskHandler(_DeskHandler):
    state: MaskState | None = None
    largest_body_bytes = LARGEST_BODY_BYTES

    async def get(self, token: str, kind: str, name: str) -> None:
        subject = self.desk.subject(kind, name)
        files, thread = self.desk.files, self.desk.masking
        self.state = await self.in_thread(thread, files.state, subject)
        self.set_header("Mask-State", json.dumps(self.state.as_dict()))
        mask = await self.in_thread(thread, files.mask, subject, self.state.standing)
        self.give(await self.in_thread(thread, _packed, mask), "application/gzip")

    async def put(self, token: str, kind: str, name: str) -> None:
        subject, role = self.desk.subject(kind, name), self.get_query_argument("role")
        if subject.size is None or role not in get_args(Role):
            raise tornado.web.HTTPError(400)
        thread = self.desk.masking
        mask = await self.in_thread(thread, _unpacked, self.body, subject.size)
        await self._change(self.desk.files.save, subject, mask, role)

    async def delete(self, token: str, kind: str, name: str) -> None:
        await self._change(self.desk.files.remove, self.desk.subject(kind, name))

    async def _change(self, change: Callable[..., Any], *what: Any) -> None:
        version = self.request.headers.get("If-Match")
        if version is None:
            raise tornado.web.HTTPError(428)
        try:
            state = await self.in_thread(self.desk.masking, change, *what, version)
        except MaskChangedError as changed:
            self.set_status(412)
            self.give_json(changed.as_dict() | {"state": changed.state.as_dict()})
            return
        self.give_json(state.as_dict())

    def write_error(self, status_code: int, **kwargs: Any) -> None:
        super().write_error(status_code, **kwargs)
        # Who starts again over a damaged mask must know its version.
        if self.state is not None:
            self.set_header("Mask-State", json.dumps(self.state.as_dict()))


class _PictureHandler(_DeskHandler):
    async def get(self, token: str, kind: str, name: str) -> None:
        subject = self.desk.subject(kind, name)
        jpeg = await self.in_thread(self.desk.drawing, self.desk.pictures.jpeg, subject)
        # The next picture is fetched ahead, and must not be made twice.
        self.set_header("Cache-Control", "private, max-age=600")
        self.give(jpeg, "image/jpeg")


class _ThumbnailHandler(_DeskHandler):
    async def get(self, token: str, kind: str, name: str) -> None:
        subject = self.desk.subject(kind, name)
        jpeg = await self.in_thread(self.desk.listing, self.desk.pictures.thumbnail, subject)
        self.set_header("Cache-Control", "private, max-age=600")
        self.give(jpeg, "image/jpeg")


class _RectangleHandler(_DeskHandler):
    """The object in a rectangle, as found by GrabCut; the mask inside the rectangle only."""

    async def post(self, token: str, kind: str, name: str) -> None:
        rectangle = _field(self.body, "rectangle")
        if not (
            isinstance(rectangle, list)
            and len(rectangle) == 4
            and all(isinstance(side, int) for side in rectangle)
        ):
            raise tornado.web.HTTPError(400)
        subject = self.desk.subject(kind, name)
        found = await self.in_thread(self.desk.drawing, self._found, subject, rectangle)
        self.give(found, "application/gzip")

    def _found(self, subject: Subject, rectangle: list[int]) -> bytes:
        # Here and not above: the page is there at once, and this takes a second to load.
        from workbench.masking.rectangle import RECTANGLE_DEFAULTS, segmented_in_rectangle

        left, top, right, bottom = rectangle
        # Whoever draws sees the edge, so that no margin is taken off it for safety.
        options = replace(RECTANGLE_DEFAULTS, erosion_px=0)
        image = self.desk.pictures.picture(subject)
        mask = segmented_in_rectangle(image, (left, top, right, bottom), options)
        return _packed(mask[top:bottom, left:right])


def _field(body: bytes, name: str) -> Any:
    try:
        return json.loads(body)[name]
    except (ValueError, KeyError, TypeError, RecursionError):
        raise tornado.web.HTTPError(400) from None


def _packed(mask: NDArray[np.uint8]) -> bytes:
    return gzip.compress(np.ascontiguousarray(mask).tobytes(), 1, mtime=0)


def _unpacked(body: bytes, size: tuple[int, int]) -> NDArray[np.uint8]:
    """A mask that was sent, never more of it than the size it should have."""
    width, height = size
    stream = zlib.decompressobj(zlib.MAX_WBITS | 16)
    try:
        content = stream.decompress(body, width * height + 1)
    except zlib.error as error:
        raise InputError("The mask did not arrive whole", found=str(error)) from error
    if len(content) != width * height or not stream.eof:
        raise InputError(
            "The mask has another size than what it belongs to",
            expected=f"{width} × {height} pixels",
        )
    return np.frombuffer(content, np.uint8).reshape(height, width)
