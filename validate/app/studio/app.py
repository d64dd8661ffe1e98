"""The web application of the workbench: who may ask, what can be asked, what comes back."""

from __future__ import annotations

import asyncio
import json
import math
from collections.abc import AsyncIterator, Callable, Mapping
from contextlib import asynccontextmanager
from importlib import resources
from typing import Any

from cboxlab.utils.errors import InputError
from cboxlab.utils.progress import Progress
from starlette.applications import Starlette
from starlette.middleware import Middleware
from starlette.requests import Request
from starlette.responses import JSONResponse, PlainTextResponse, Response, StreamingResponse
from starlette.routing import Mount, Route
from starlette.types import ASGIApp, Receive, Scope, Send

from ...report.viewer import viewer_data, viewer_script, viewer_style
from .jobs import Jobs
from .places import known_places
from .wire import catalogue_record, study_record, view
from .workbench import Workbench

__all__ = ["build_app"]

_LARGEST_BODY = 1 << 16

#: Seconds without a step of the user after which light transport is rendered in the background.
_IDLE_S = 1.5

_HEADERS = {
    "Cache-Control": "no-store",
    "Referrer-Policy": "no-referrer",
    "X-Content-Type-Options": "nosniff",
    "Content-Security-Policy": "default-src 'self'; style-src 'self' 'unsafe-inline'; img-src 'self' data: blob:; "
    "frame-ancestors 'none'; base-uri 'none'; form-action 'none'",
}


def _own(name: str) -> Callable[[], str]:
    return lambda: (resources.files(__package__) / "page" / name).read_text(encoding="utf-8")


#: The page's files: media type and content.
_PAGE: Mapping[str, tuple[str, Callable[[], str]]] = {
    "index.html": ("text/html", _own("index.html")),
    "studio.js": ("text/javascript", _own("studio.js")),
    "controls.js": ("text/javascript", _own("controls.js")),
    "studio.css": ("text/css", _own("studio.css")),
    "viewer.js": ("text/javascript", viewer_script),
    "viewer.css": ("text/css", viewer_style),
}


class _Guard:
    """Refuses requests for another host (a foreign page whose name resolves to this machine) or from another page."""

    def __init__(self, app: ASGIApp, hosts: frozenset[str] | None) -> None:
        self._app, self._hosts = app, hosts

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] == "http":
            headers = {key.decode("latin-1"): value.decode("latin-1") for key, value in scope["headers"]}
            host, origin = headers.get("host", ""), headers.get("origin")
            name = host.rsplit(":", 1)[0] if not host.endswith("]") else host
            foreign = self._hosts is not None and name not in self._hosts
            if foreign or (origin is not None and origin.partition("://")[2] != host):
                await PlainTextResponse("not from here\n", 403)(scope, receive, send)
                return
        await self._app(scope, receive, send)


class _Handlers:
    def __init__(self, bench: Workbench, jobs: Jobs, idle_s: float) -> None:
        self.bench, self.jobs, self.idle_s = bench, jobs, idle_s
        self._later: asyncio.Task[None] | None = None
        self._saved: list[str] = []

    async def file(self, request: Request) -> Response:
        """One of the page's files; nothing else of the disk is ever read for a name in a request."""
        path = request.path_params
        name = f"{path['name']}.{path['kind']}" if path else "index.html"
        if name not in _PAGE:
            return PlainTextResponse("not here\n", 404)
        kind, made = _PAGE[name]
        return Response(made(), media_type=kind, headers=_HEADERS)

    async def state(self, request: Request) -> Response:
        """What is known, and what runs; without waiting for a computation."""
        record = {"open": self.bench.is_open}
        if not self.jobs.busy:
            record = await self.jobs.quick(lambda: study_record(self.bench))
        return JSONResponse({**record, "job": self.jobs.told, "error": self.jobs.error}, headers=_HEADERS)

    async def picture(self, request: Request) -> Response:
        """All that the viewer needs of the capture shown."""

        data = await self.jobs.quick(lambda: viewer_data(self.bench.prediction.base.validation))
        return JSONResponse(data, headers=_HEADERS)

    async def view(self, request: Request) -> Response:
        return await self._viewed(lambda: None)

    async def effects(self, request: Request) -> Response:
        return JSONResponse(await self.jobs.quick(lambda: catalogue_record(self.bench)), headers=_HEADERS)

    async def places(self, request: Request) -> Response:
        found = await asyncio.to_thread(known_places, self.bench.root)
        return JSONResponse(found, headers=_HEADERS)

    async def step(self, request: Request) -> Response:
        """A short step: the study as it is after it."""
        name, body, bench = request.path_params["name"], await _body(request), self.bench
        which = _whole(body, "which")
        steps: Mapping[str, Callable[[], None]] = {
            "add": lambda: bench.add(_text(body, "effect"), _values(body)),
            "change": lambda: bench.change(which, _values(body), bool(body.get("commit"))),
            "remove": lambda: bench.remove(which),
            "undo": bench.undo,
            "redo": bench.redo,
            "adopt": bench.adopt,
            "show": lambda: bench.show(_whole(body, "capture"), bool(body.get("refit", True))),
        }
        if name not in steps:
            raise InputError("the request", repr(name), f"one of {', '.join(steps)}")
        return await self._viewed(steps[name])

    async def _viewed(self, step: Callable[[], None]) -> Response:
        def made() -> bytes:
            step()
            return view(self.bench)

        content = await self.jobs.quick(made)
        self._render_later()
        return Response(content, media_type="application/octet-stream", headers=_HEADERS)

    async def job(self, request: Request) -> Response:
        """Begin a long computation; its progress and end come as events."""
        name, body, bench = request.path_params["name"], await _body(request), self.bench
        which, report = body.get("which", []), bool(body.get("report"))
        if not isinstance(which, list) or not all(isinstance(one, int) for one in which):
            raise InputError("which", repr(which), "a list of indices of effects")

        def save(progress: Progress) -> None:
            self._saved = bench.save(_text(body, "folder"), report, progress)

        jobs: Mapping[str, Callable[[Progress], None]] = {
            "open": lambda p: bench.open(_text(body, "capture"), body.get("model") or None, p),
            "model": lambda p: bench.open_model(_text(body, "model"), p),
            "fit": lambda p: bench.fit(which, p),
            "render": bench.render,
            "diagnose": bench.diagnose,
            "save": save,
        }
        if name not in jobs:
            raise InputError("the request", repr(name), f"one of {', '.join(jobs)}")
        await self.jobs.start(name, jobs[name], self.changed)
        return JSONResponse({"job": name}, 202, headers=_HEADERS)

    async def cancel(self, request: Request) -> Response:
        body = await _body(request)
        if not (body.get("background") and self.jobs.busy):
            await self.jobs.cancel()
        return JSONResponse({}, headers=_HEADERS)

    async def events(self, request: Request) -> Response:
        queue = self.jobs.listen()

        async def lines() -> AsyncIterator[str]:
            try:
                yield ": here\n\n"
                while True:
                    try:
                        event = await asyncio.wait_for(queue.get(), 15.0)
                        yield f"data: {json.dumps(event, allow_nan=False)}\n\n"
                    except TimeoutError:
                        yield ": still here\n\n"
            finally:
                self.jobs.forget(queue)

        return StreamingResponse(lines(), media_type="text/event-stream", headers=_HEADERS)

    async def changed(self) -> None:
        """Tell the page that a long computation has changed the study."""
        saved, self._saved = self._saved, []
        self.jobs.tell({"event": "changed", "saved": saved})
        self._render_later()

    def _render_later(self) -> None:
        """Render light transport once the user has been still for a while."""
        if self._later is not None:
            self._later.cancel()
        self._later = asyncio.create_task(self._render_idle())

    async def _render_idle(self) -> None:
        await asyncio.sleep(self.idle_s)
        if self.bench.improvable and self.jobs.heard and self.jobs.told is None:
            await self.jobs.start("render", self.bench.render, self.changed, background=True)


def build_app(
    bench: Workbench,
    token: str,
    hosts: frozenset[str] | None,
    *,
    idle_s: float = _IDLE_S,
    begin: Callable[[Progress], None] | None = None,
) -> Starlette:
    """The application under the path /token/ ("" for /).

    hosts : names of this machine that a request may be for, None for any. idle_s : seconds without a step of the user
    after which light transport is rendered in the background. begin : a computation to begin with.
    """
    jobs = Jobs()
    handlers = _Handlers(bench, jobs, idle_s)
    routes = [
        Route("/", handlers.file),
        Route("/{name}.{kind:str}", handlers.file),
        Route("/api/state", handlers.state),
        Route("/api/picture", handlers.picture),
        Route("/api/view", handlers.view),
        Route("/api/effects", handlers.effects),
        Route("/api/places", handlers.places),
        Route("/api/events", handlers.events),
        Route("/api/cancel", handlers.cancel, methods=["POST"]),
        Route("/api/step/{name:str}", handlers.step, methods=["POST"]),
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
        exception_handlers={InputError: _told},
        lifespan=lifespan,
    )


async def _told(request: Request, error: Exception) -> Response:
    return JSONResponse({"error": str(error)}, 400, headers=_HEADERS)


async def _body(request: Request) -> dict[str, Any]:
    """The request's JSON object. Raises InputError for anything else."""
    expected = "a JSON object"
    if request.headers.get("content-type", "").partition(";")[0] != "application/json":
        raise InputError("the request", "no application/json", expected)
    text = b""
    async for part in request.stream():
        text += part
        if len(text) > _LARGEST_BODY:
            raise InputError("the request", "too long a body", f"{_LARGEST_BODY} bytes at most")
    try:
        content = json.loads(text or b"{}")
    except (ValueError, RecursionError):
        content = None
    if not isinstance(content, dict):
        raise InputError("the request", repr(text[:40]), expected)
    return content


def _text(body: Mapping[str, Any], key: str) -> str:
    value = body.get(key)
    if not isinstance(value, str) or not value.strip():
        raise InputError(key, "nothing" if not value else repr(value), "a name")
    return value.strip()


def _whole(body: Mapping[str, Any], key: str) -> int:
    value = body.get(key, 0)
    if not isinstance(value, int):
        raise InputError(key, repr(value), "an index from 0")
    return value


def _values(body: Mapping[str, Any]) -> dict[str, Any]:
    """An effect's values; infinity, which JSON lacks, comes as "inf"."""
    values = body.get("values", {})
    if not isinstance(values, dict):
        raise InputError("values", repr(values), "a value for each parameter")
    return {str(key): math.inf if value == "inf" else value for key, value in values.items()}
