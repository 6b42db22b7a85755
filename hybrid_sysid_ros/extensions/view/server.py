"""Server: hands the page out on this computer, shows it a rig, and hears what it asks for; a thread of its own."""

from __future__ import annotations

import asyncio
import hmac
import json
import logging
from collections.abc import Mapping
from dataclasses import dataclass, field
from http import HTTPStatus
from importlib.resources import files
from threading import Event, Thread
from typing import Any, Protocol
from urllib.parse import parse_qs

from hybrid_sysid_ros.extensions.view.page_token import NONCE, page_token, proof
from hybrid_sysid_ros.extensions.view.requests import LARGEST, Next, Request, RequestMenu, read_request
from hybrid_sysid_ros.extensions.view.tables import Cursor
from hybrid_sysid_ros.support.errors import UserError
from hybrid_sysid_ros.support.extras import extra

with extra("view"):
    from websockets.asyncio.server import ServerConnection, serve
    from websockets.datastructures import Headers
    from websockets.exceptions import ConnectionClosed
    from websockets.http11 import Request as HttpRequest
    from websockets.http11 import Response

ADDRESS = "127.0.0.1"
LIVE = "/live"
"""Path of the websocket, which needs the token."""
PROOF = "/proof"
"""Path by which a page asks whether this is the server of its token; everything else is one of the FILES."""
SCRIPTS = ("page", "charts", "connection", "controls", "drawing", "model", "operation", "rigcharts")
FILES = {
    "/": ("index.html", "text/html"),
    **{f"/{name}.js": (f"{name}.js", "text/javascript") for name in SCRIPTS},
    "/style.css": ("style.css", "text/css"),
    "/uplot.js": ("uPlot.iife.min.js", "text/javascript"),
    "/uplot.css": ("uPlot.min.css", "text/css"),
}
"""All that can be asked for, by path: no part of a path ever names a file."""
PAGES = 8
"""Open at a time, at most."""
AT_ONCE = 8
"""Requests of a page that wait for an answer."""
REFUSALS = 100
"""Of a page, after which it is shown the door."""
ALONE = 0.2
"""Seconds between two looks at the rig while no page is open."""


class ViewService(Protocol):
    """What a server serves. All but ``collect`` is called in the server's thread."""

    offered: RequestMenu

    def greeting(self) -> Mapping[str, Any]:
        """What a page must know once, as plain data."""

    def collect(self) -> None:
        """Take in what the rig has said."""

    def frame(self, cursor: Cursor) -> bytes:
        """What is new since a cursor."""

    async def act(self, request: Request) -> str:
        """Do what a page asks for; a line about it. Raises UserError."""


@dataclass(eq=False)
class Page:
    """One that is open."""

    connection: ServerConnection
    cursor: Cursor = field(default_factory=Cursor)
    wants: asyncio.Event = field(default_factory=asyncio.Event)
    """It has drawn what it had. A page that is slow, or hidden, asks for less, and costs less."""
    waiting: set[asyncio.Task[None]] = field(default_factory=set)
    refused: int = 0


class Server:
    """One rig on a port of this computer, for pages that know its token."""

    def __init__(self, service: ViewService, *, port: int, pictures: float) -> None:
        """port: 0 for any that is free. pictures: a second, at most."""
        self.token = page_token(port)
        self.port = port
        self.pages: set[Page] = set()
        self.sent = self.refused = 0
        """Pictures, and requests that were refused, so far."""
        self._service, self._period = service, 1.0 / pictures
        self._ready, self._trouble = Event(), ""
        self._loop: asyncio.AbstractEventLoop | None = None
        self._end: asyncio.Event | None = None
        self._thread = Thread(target=self._run, name="view", daemon=True)

    @property
    def url(self) -> str:
        """Where the page is. A browser tells no server what stands behind the #: the page keeps it, and tells it to a
        server that knows it already.
        """
        return f"http://{ADDRESS}:{self.port}/#token={self.token}"

    @property
    def hosts(self) -> tuple[str, str]:
        """Names by which a browser on this computer calls it."""
        return f"{ADDRESS}:{self.port}", f"localhost:{self.port}"

    def start(self) -> None:
        """Serve from now on. Raises UserError where the port is taken."""
        self._thread.start()
        self._ready.wait()
        if self._trouble:
            raise UserError(self._trouble)

    def close(self) -> None:
        """Serve no longer; may be called more than once."""
        if self._loop is not None and self._end is not None and self._thread.is_alive():
            self._loop.call_soon_threadsafe(self._end.set)
            self._thread.join()

    def _run(self) -> None:
        quiet = logging.Logger("view", logging.CRITICAL + 1)  # what strangers send is no news
        try:
            asyncio.run(self._serve(quiet))
        except OSError as error:
            self._trouble = f"port {self.port}: {error.strerror}: give another one by --port, 0 for any"
        finally:
            self._ready.set()

    async def _serve(self, logger: logging.Logger) -> None:
        self._loop, self._end, self._turn = asyncio.get_running_loop(), asyncio.Event(), asyncio.Event()
        async with serve(
            self._attend,
            ADDRESS,
            self.port,
            process_request=self._answer,
            max_size=LARGEST,
            max_queue=4,
            compression=None,
            close_timeout=1.0,
            open_timeout=5.0,
            server_header=None,
            logger=logger,
        ) as listening:
            self.port = int(next(iter(listening.sockets)).getsockname()[1])
            self._ready.set()
            while not self._end.is_set():
                self._service.collect()
                turn, self._turn = self._turn, asyncio.Event()
                turn.set()
                try:
                    await asyncio.wait_for(self._end.wait(), self._period if self.pages else ALONE)
                except asyncio.TimeoutError:
                    continue
            self._turn.set()

    def _answer(self, connection: ServerConnection, request: HttpRequest) -> Response | None:
        """The answer to a request of HTTP; None where it may go on as a websocket."""
        hosts = request.headers.get_all("Host")
        if len(hosts) != 1 or hosts[0] not in self.hosts:
            return _response(HTTPStatus.FORBIDDEN, "this page is served to this computer only\n")
        path, _, query = request.path.partition("?")
        if path not in (*FILES, LIVE, PROOF):
            return _response(HTTPStatus.NOT_FOUND, "no such page\n")
        if path == PROOF:
            return self._proof(query)
        if path == LIVE and not self._is_known(query):
            return _response(
                HTTPStatus.FORBIDDEN,
                "the token is missing or old: open the address that hybrid-sysid view has printed\n",
            )
        if path != LIVE:
            name, kind = FILES[path]
            content = (files("hybrid_sysid_ros.extensions.view") / "page" / name).read_bytes()
            return _response(HTTPStatus.OK, content, kind)
        origins = request.headers.get_all("Origin")
        if len(origins) != 1 or origins[0] not in [f"http://{host}" for host in self.hosts]:
            return _response(HTTPStatus.FORBIDDEN, "this websocket is for the page of this server only\n")
        if len(self.pages) >= PAGES:
            return _response(HTTPStatus.SERVICE_UNAVAILABLE, f"{PAGES} pages are open: close one\n")
        return None

    def _proof(self, query: str) -> Response:
        nonce = query.removeprefix("nonce=")
        if not NONCE.fullmatch(nonce):
            return _response(HTTPStatus.BAD_REQUEST, "a proof needs nonce=, and 32 hexadecimal digits\n")
        return _response(HTTPStatus.OK, proof(self.token, nonce))

    def _is_known(self, query: str) -> bool:
        tokens = parse_qs(query, max_num_fields=4).get("token", []) if query.count("&") < 4 else []
        return len(tokens) == 1 and hmac.compare_digest(tokens[0].encode(errors="replace"), self.token.encode())

    async def _attend(self, connection: ServerConnection) -> None:
        """Show a page the rig and hear it, until it is closed."""
        page = Page(connection)
        self.pages.add(page)
        showing = asyncio.create_task(self._show(page))
        try:
            await connection.send(json.dumps(self._service.greeting(), allow_nan=False))
            async for text in connection:
                await self._receive(page, text)
        except ConnectionClosed:
            return
        finally:
            self.pages.discard(page)
            for task in (showing, *page.waiting):
                task.cancel()

    async def _show(self, page: Page) -> None:
        """One picture for each time that a page wants one."""
        try:
            while True:
                await page.wants.wait()
                await self._turn.wait()
                page.wants.clear()
                await page.connection.send(self._service.frame(page.cursor))
                self.sent += 1
        except ConnectionClosed:
            return

    async def _receive(self, page: Page, text: str | bytes) -> None:
        number = 0
        try:
            request = read_request(text, self._service.offered)
            if isinstance(request, Next):
                page.wants.set()
                return
            number = request.id
            if len(page.waiting) >= AT_ONCE:
                raise UserError(f"{AT_ONCE} requests wait for an answer: wait, too")
        except UserError as error:
            self.refused += 1
            page.refused += 1
            await self._reply(page, number, done=False, line=str(error))
            if page.refused >= REFUSALS:
                await page.connection.close(1008, f"{REFUSALS} requests made no sense")
            return
        task = asyncio.create_task(self._act(page, request))
        page.waiting.add(task)
        task.add_done_callback(page.waiting.discard)

    async def _act(self, page: Page, request: Request) -> None:
        try:
            done, line = True, await self._service.act(request)
        except UserError as error:
            self.refused += 1
            done, line = False, str(error)
        await self._reply(page, request.id, done=done, line=line)

    async def _reply(self, page: Page, number: int, *, done: bool, line: str) -> None:
        line = " ".join(line.split())[:500]
        try:
            await page.connection.send(json.dumps({"answer": number, "done": done, "line": line}))
        except ConnectionClosed:
            return


def _response(status: HTTPStatus, content: str | bytes, kind: str = "text/plain") -> Response:
    body = content.encode() if isinstance(content, str) else content
    headers = {
        "Content-Type": f"{kind}; charset=utf-8",
        "Content-Length": str(len(body)),
        "Connection": "close",
        "Cache-Control": "no-store",
        "Content-Security-Policy": "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' data:; "
        "connect-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'",
        "X-Content-Type-Options": "nosniff",
        "Referrer-Policy": "no-referrer",
        "Cross-Origin-Resource-Policy": "same-origin",
    }
    return Response(status.value, status.phrase, Headers(headers), body)
