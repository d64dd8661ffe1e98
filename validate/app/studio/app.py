"""Web application of the workbench: access, requests and answers."""

from __future__ import annotations

import asyncio
import json
from collections.abc import AsyncIterator, Callable, Mapping
from contextlib import asynccontextmanager
from importlib import resources
from ipaddress import ip_address
from typing import Any

from cboxlab.utils.errors import InputError
from cboxlab.utils.progress import Progress
from starlette.applications import Starlette
from starlette.middleware import Middleware
from starlette.requests import ClientDisconnect, Request
from starlette.responses import JSONResponse, PlainTextResponse, Response, StreamingResponse
from starlette.routing import Mount, Route
from starlette.types import ASGIApp, Receive, Scope, Send

from ...report.viewer import viewer_data, viewer_part, viewer_script, viewer_style
from .autosave import discard_unsaved
from .boards import Boards
from .bodies import flag_of, index_of, json_body, list_of, optional_text, text_of, values_of
from .first_capture import FirstCaptures
from .jobs import Jobs
from .labelling import Labelling
from .picker import Picker
from .places import list_inputs
from .wire import catalogue_record, earlier_view, flip_record, pattern_view, study_record, view
from .workbench import EarlierStateError, Workbench

__all__ = ["ANY_ADDRESS", "IDLE_S", "build_app"]

#: Entry of the host names of ``build_app`` that stands for every IP address.
ANY_ADDRESS = "*"

#: Time without a step of the user after which light transport is rendered in the background, s.
IDLE_S = 1.5

#: Interval of comments that keep the stream of events open, s.
_KEEP_ALIVE_S = 15.0

#: Header with the number of the state after a step.
_REVISION_HEADER = "CBox-Revision"

#: Headers of every answer: nothing is cached, and the page loads nothing from other hosts.
_HEADERS = {
    "Cache-Control": "no-store",
    "Referrer-Policy": "no-referrer",
    "X-Content-Type-Options": "nosniff",
    "Content-Security-Policy": "default-src 'self'; style-src 'self' 'unsafe-inline'; img-src 'self' data: blob:; "
    "frame-ancestors 'none'; base-uri 'none'; form-action 'none'",
}


def _page_file(name: str) -> Callable[[], str]:
    """Function that reads a file of the page."""
    return lambda: (resources.files(__package__) / "page" / name).read_text(encoding="utf-8")


#: Files of the page: media type and function that returns the content.
_PAGE: Mapping[str, tuple[str, Callable[[], str]]] = {
    "index.html": ("text/html", _page_file("index.html")),
    "studio.js": ("text/javascript", _page_file("studio.js")),
    "controls.js": ("text/javascript", _page_file("controls.js")),
    "first.html": ("text/html", _page_file("first.html")),
    "first.js": ("text/javascript", _page_file("first.js")),
    "first.css": ("text/css", _page_file("first.css")),
    "points.html": ("text/html", _page_file("points.html")),
    "points.js": ("text/javascript", _page_file("points.js")),
    "boards.html": ("text/html", _page_file("boards.html")),
    "boards.js": ("text/javascript", _page_file("boards.js")),
    "labels.html": ("text/html", _page_file("labels.html")),
    "labels.js": ("text/javascript", _page_file("labels.js")),
    "marking.js": ("text/javascript", _page_file("marking.js")),
    "photograph.js": ("text/javascript", _page_file("photograph.js")),
    "text.js": ("text/javascript", lambda: viewer_part("text.js")),
    "arrays.js": ("text/javascript", lambda: viewer_part("arrays.js")),
    "studio.css": ("text/css", _page_file("studio.css")),
    "viewer.js": ("text/javascript", viewer_script),
    "viewer.css": ("text/css", viewer_style),
}


#: Body of the answer to a request from another page or for another host name.
_FOREIGN = (
    "Refused: the request comes from another page, or is for another host name. Open the address that cbox printed.\n"
)
#: Body of the answer to a request for an unknown file.
_UNKNOWN = "The workbench has no file of this name. Open the address that cbox printed.\n"


def _is_address(name: str) -> bool:
    """Whether a host name is an IP address, which no foreign page can make its name."""
    try:
        ip_address(name.strip("[]"))
    except ValueError:
        return False
    return True


class _Guard:
    """Refusal of requests for another host name, and from other pages.

    The host name of a foreign page may resolve to this computer.
    """

    def __init__(self, app: ASGIApp, hosts: frozenset[str]) -> None:
        self._app, self._hosts = app, hosts

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] == "http":
            headers = {key.decode("latin-1"): value.decode("latin-1") for key, value in scope["headers"]}
            host, origin = headers.get("host", ""), headers.get("origin")
            name = host.rsplit(":", 1)[0] if not host.endswith("]") else host
            any_address = ANY_ADDRESS in self._hosts and _is_address(name)
            foreign = not any_address and name not in self._hosts - {ANY_ADDRESS}
            if foreign or (origin is not None and origin.partition("://")[2] != host):
                await PlainTextResponse(_FOREIGN, 403)(scope, receive, send)
                return
        await self._app(scope, receive, send)


class _Handlers:
    """Answers to the requests of the page."""

    def __init__(self, bench: Workbench, jobs: Jobs, idle_s: float) -> None:
        self.bench, self.jobs, self.idle_s = bench, jobs, idle_s
        self._picker, self._labelling, self._boards = Picker(bench.root), Labelling(bench.root), Boards(bench.root)
        self._firsts = FirstCaptures(bench.root)
        self._later: asyncio.Task[None] | None = None
        self._saved: list[str] = []
        #: Last answers by name, for pages that ask during a computation.
        self._last: dict[str, Any] = {}

    async def _latest(self, name: str, function: Callable[[], Any]) -> Any:
        """Result of a short computation; during a long one the last result of this name."""
        if not (self.jobs.busy and name in self._last):
            self._last[name] = await self.jobs.quick(function)
        return self._last[name]

    async def file(self, request: Request) -> Response:
        """One of the page's files; no other file is read for a name in a request."""
        path = request.path_params
        name = f"{path['name']}.{path['kind']}" if path else "index.html"
        if name not in _PAGE:
            return PlainTextResponse(_UNKNOWN, 404)
        kind, content = _PAGE[name]
        return Response(content(), media_type=kind, headers=_HEADERS)

    async def state(self, request: Request) -> Response:
        """State of the study and of the running computation, without waiting for it."""
        record: dict[str, Any] = {"open": self.bench.is_open, "revision": self.bench.revision}
        if not self.jobs.busy:
            record = await self.jobs.quick(lambda: study_record(self.bench))
        return JSONResponse({**record, "job": self.jobs.progress, "error": self.jobs.error}, headers=_HEADERS)

    async def picture(self, request: Request) -> Response:
        """Data of the viewer for the capture in view."""
        data = await self._latest("picture", lambda: viewer_data(self.bench.prediction.base.validation))
        return JSONResponse(data, headers=_HEADERS)

    async def view(self, request: Request) -> Response:
        """Study and predicted pictures."""
        content = await self._latest("view", lambda: view(self.bench))
        return Response(content, media_type="application/octet-stream", headers=_HEADERS)

    async def flip(self, request: Request) -> Response:
        """FLIP of the photograph and the predicted picture."""
        return JSONResponse(await self.jobs.quick(lambda: flip_record(self.bench)), headers=_HEADERS)

    async def pattern(self, request: Request) -> Response:
        """Patterns of an effect that is not added."""
        effect = text_of(await json_body(request), "effect")
        content = await self.jobs.quick(lambda: pattern_view(self.bench, effect))
        self._render_later()
        return Response(content, media_type="application/octet-stream", headers=_HEADERS)

    async def earlier(self, request: Request) -> Response:
        """Predicted pictures of an earlier state."""
        is_first = flag_of(await json_body(request), "first")
        content = await self.jobs.quick(lambda: earlier_view(self.bench, is_first))
        self._render_later()
        return Response(content, media_type="application/octet-stream", headers=_HEADERS)

    async def effects(self, request: Request) -> Response:
        """Catalogue of effects."""
        return JSONResponse(await self._latest("effects", lambda: catalogue_record(self.bench)), headers=_HEADERS)

    async def inputs(self, request: Request) -> Response:
        """Captures, studies and models that can be opened."""
        names = await asyncio.to_thread(list_inputs, self.bench.root)
        return JSONResponse(names, headers=_HEADERS)

    async def discard(self, request: Request) -> Response:
        """Remove unsaved work that the list of inputs has."""
        name = text_of(await json_body(request), "study")
        await self.jobs.quick(lambda: discard_unsaved(self.bench.root, name))
        return JSONResponse({}, headers=_HEADERS)

    async def step(self, request: Request) -> Response:
        """Do a short step; the answer is the study after it."""
        name, body, bench = request.path_params["name"], await json_body(request), self.bench
        which = index_of(body, "which")
        steps: Mapping[str, Callable[[], None]] = {
            "add": lambda: bench.add(text_of(body, "effect"), values_of(body)),
            "change": lambda: bench.change(which, values_of(body), flag_of(body, "commit")),
            "remove": lambda: bench.remove(which),
            "undo": bench.undo,
            "redo": bench.redo,
            "adopt": bench.adopt,
            "show": lambda: bench.show(index_of(body, "capture"), flag_of(body, "refit", True)),
        }
        if name not in steps:
            raise InputError("the request", repr(name), f"one of {', '.join(steps)}")

        def run() -> bytes:
            bench.require_revision(index_of(body, "revision"))
            steps[name]()
            return view(bench)

        before = bench.revision
        content = self._last["view"] = await self.jobs.quick(run)
        if bench.revision != before:
            self.jobs.send({"event": "moved", "revision": bench.revision, "tab": optional_text(body, "tab")})
        self._render_later()
        headers = {**_HEADERS, _REVISION_HEADER: str(bench.revision)}
        return Response(content, media_type="application/octet-stream", headers=headers)

    async def points(self, request: Request) -> Response:
        """Corners of a capture's photograph, their positions, or the file of them."""
        name, body, picker = request.path_params["name"], await json_body(request), self._picker
        capture, marks = text_of(body, "capture"), list_of(body, "points")
        steps: Mapping[str, Callable[[], dict[str, Any]]] = {
            "picture": lambda: picker.picture(capture),
            "locate": lambda: picker.locate(capture, marks, flag_of(body, "by_edges")),
            "write": lambda: picker.write(capture, marks),
        }
        if name not in steps:
            raise InputError("the request", repr(name), f"one of {', '.join(steps)}")
        return JSONResponse(await self.jobs.quick(steps[name]), headers=_HEADERS)

    async def labels(self, request: Request) -> Response:
        """Photograph and labels of a capture, pixels of drawn shapes, or the files of them."""
        name, body, labelling = request.path_params["name"], await json_body(request), self._labelling
        capture, shapes, names = text_of(body, "capture"), list_of(body, "shapes"), list_of(body, "names")
        base = flag_of(body, "base")
        steps: Mapping[str, Callable[[], dict[str, Any]]] = {
            "picture": lambda: labelling.picture(capture),
            "chart": lambda: labelling.chart(capture),
            "count": lambda: labelling.count(capture, shapes, base),
            "write": lambda: labelling.write(capture, shapes, names, base, flag_of(body, "replace")),
        }
        if name not in steps:
            raise InputError("the request", repr(name), f"one of {', '.join(steps)}")
        return JSONResponse(await self.jobs.quick(steps[name]), headers=_HEADERS)

    async def boards(self, request: Request) -> Response:
        """Boards of a capture, one of their frames, the fitted lens, or a changed capture.toml."""
        name, body, boards = request.path_params["name"], await json_body(request), self._boards
        capture, dropped = text_of(body, "capture"), list_of(body, "dropped", str)
        steps: Mapping[str, Callable[[], dict[str, Any]]] = {
            "views": lambda: boards.views(capture),
            "frame": lambda: boards.frame(capture, text_of(body, "frame")),
            "fit": lambda: boards.fit(capture, dropped),
            "write": lambda: boards.write(capture, dropped),
        }
        if name not in steps:
            raise InputError("the request", repr(name), f"one of {', '.join(steps)}")
        return JSONResponse(await self.jobs.quick(steps[name]), headers=_HEADERS)

    async def first(self, request: Request) -> Response:
        """Form of a folder's first capture.toml, its small pictures, or its file."""
        firsts = self._firsts
        name, body = request.path_params["name"], await json_body(request)
        folder, entries, roles = text_of(body, "folder"), list_of(body, "entries"), list_of(body, "roles")
        frames = list_of(body, "frames", str)
        steps: Mapping[str, Callable[[], dict[str, Any]]] = {
            "draft": lambda: firsts.draft(folder, entries, roles),
            "write": lambda: firsts.write(folder, entries, roles),
            "thumbnails": lambda: firsts.thumbnails(folder, frames),
        }
        if name not in steps:
            raise InputError("the request", repr(name), f"one of {', '.join(steps)}")
        return JSONResponse(await self.jobs.quick(steps[name]), headers=_HEADERS)

    async def job(self, request: Request) -> Response:
        """Start a long computation; its progress and end are sent as events."""
        name, body, bench = request.path_params["name"], await json_body(request), self.bench
        which, report = list_of(body, "which", int), flag_of(body, "report")
        if which or name == "profile":
            bench.require_revision(index_of(body, "revision"))

        def save(progress: Progress) -> None:
            self._saved = bench.save(text_of(body, "folder"), report, progress)

        jobs: Mapping[str, Callable[[Progress], None]] = {
            "open": lambda p: bench.open(text_of(body, "capture"), optional_text(body, "model"), p),
            "model": lambda p: bench.open_model(text_of(body, "model"), p),
            "fit": lambda p: bench.fit(which, p),
            "render": bench.render,
            "diagnose": bench.diagnose,
            "profile": lambda p: bench.compute_profile(index_of(body, "effect"), text_of(body, "parameter"), p),
            "save": save,
        }
        if name not in jobs:
            raise InputError("the request", repr(name), f"one of {', '.join(jobs)}")
        await self.jobs.start(name, jobs[name], self.changed)
        return JSONResponse({"job": name}, 202, headers=_HEADERS)

    async def cancel(self, request: Request) -> Response:
        """Stop the computation; with ``background`` only one that the user did not start."""
        body = await json_body(request)
        if not (flag_of(body, "background") and self.jobs.busy):
            await self.jobs.cancel()
        return JSONResponse({}, headers=_HEADERS)

    async def events(self, request: Request) -> Response:
        """Stream of events: progress, end, changed."""
        queue = self.jobs.listen()

        async def lines() -> AsyncIterator[str]:
            try:
                yield ": open\n\n"
                while True:
                    try:
                        event = await asyncio.wait_for(queue.get(), _KEEP_ALIVE_S)
                        yield f"data: {json.dumps(event, allow_nan=False)}\n\n"
                    except TimeoutError:
                        yield ": open\n\n"
            finally:
                self.jobs.forget(queue)

        return StreamingResponse(lines(), media_type="text/event-stream", headers=_HEADERS)

    async def changed(self) -> None:
        """Send the event that a long computation has changed the study."""
        saved, self._saved = self._saved, []
        self.jobs.send({"event": "changed", "saved": saved})
        self._render_later()

    def _render_later(self) -> None:
        """Render light transport after a time without a step of the user."""
        if self._later is not None:
            self._later.cancel()
        self._later = asyncio.create_task(self._render_idle())

    async def _render_idle(self) -> None:
        await asyncio.sleep(self.idle_s)
        if self.bench.improvable and self.jobs.has_listeners and self.jobs.progress is None:
            await self.jobs.start("render", self.bench.render, self.changed, background=True)


def build_app(
    bench: Workbench,
    token: str,
    hosts: frozenset[str],
    *,
    idle_s: float = IDLE_S,
    begin: Callable[[Progress], None] | None = None,
) -> Starlette:
    """Web application of a workbench.

    Parameters
    ----------
    bench
        The workbench.
    token
        Secret of the page's path, /token/; "" for the path /.
    hosts
        Host names that a request may be for. ``ANY_ADDRESS`` allows every IP address besides.
    idle_s
        Time without a step of the user after which light transport is rendered in the background, s.
    begin
        Computation to start with; None for none.

    Returns
    -------
    Starlette
        The application.
    """
    jobs = Jobs()
    handlers = _Handlers(bench, jobs, idle_s)
    routes = [
        Route("/", handlers.file),
        Route("/{name}.{kind:str}", handlers.file),
        Route("/api/state", handlers.state),
        Route("/api/picture", handlers.picture),
        Route("/api/view", handlers.view),
        Route("/api/flip", handlers.flip),
        Route("/api/effects", handlers.effects),
        Route("/api/places", handlers.inputs),
        Route("/api/events", handlers.events),
        Route("/api/cancel", handlers.cancel, methods=["POST"]),
        Route("/api/discard", handlers.discard, methods=["POST"]),
        Route("/api/pattern", handlers.pattern, methods=["POST"]),
        Route("/api/earlier", handlers.earlier, methods=["POST"]),
        Route("/api/step/{name:str}", handlers.step, methods=["POST"]),
        Route("/api/first/{name:str}", handlers.first, methods=["POST"]),
        Route("/api/points/{name:str}", handlers.points, methods=["POST"]),
        Route("/api/labels/{name:str}", handlers.labels, methods=["POST"]),
        Route("/api/boards/{name:str}", handlers.boards, methods=["POST"]),
        Route("/api/job/{name:str}", handlers.job, methods=["POST"]),
    ]

    @asynccontextmanager
    async def lifespan(app: Starlette) -> AsyncIterator[None]:
        if begin is not None:
            await jobs.start("open", begin, handlers.changed)
        yield
        jobs.close()

    return Starlette(
        routes=[Mount(f"/{token}", routes=routes)] if token else routes,
        middleware=[Middleware(_Guard, hosts=hosts)],
        exception_handlers={EarlierStateError: _earlier, InputError: _refusal, ClientDisconnect: _no_listener},
        lifespan=lifespan,
    )


async def _refusal(request: Request, error: Exception) -> Response:
    """Answer to a request with faulty input."""
    return JSONResponse({"error": str(error)}, 400, headers=_HEADERS)


async def _earlier(request: Request, error: Exception) -> Response:
    """Answer to a step that was made on an earlier state."""
    return JSONResponse({"error": str(error)}, 409, headers=_HEADERS)


async def _no_listener(request: Request, error: Exception) -> Response:
    """Answer to a client that closed the connection, which nobody receives."""
    return Response(status_code=400)
