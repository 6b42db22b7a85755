"""The server of the live view: what strangers, wrong pages and nonsense get, and that others do not notice."""

from __future__ import annotations

import hmac
import http.client
import json
import socket
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from dataclasses import dataclass, field
from typing import Any

import pytest

pytest.importorskip("websockets", reason="needs websockets: install hybrid_sysid_ros[view]")

from websockets.exceptions import ConnectionClosed, InvalidStatus
from websockets.sync.client import ClientConnection, connect

from hybrid_sysid_ros.extensions.view.requests import Request, RequestMenu
from hybrid_sysid_ros.extensions.view.server import FILES, PAGES, REFUSALS, Server
from hybrid_sysid_ros.extensions.view.tables import Cursor, Tables, unpacked
from hybrid_sysid_ros.extensions.view.tests.test_requests import NONSENSE
from hybrid_sysid_ros.rigs.rig import Rig
from hybrid_sysid_ros.support.errors import UserError

PATIENCE = 10.0  # s


@dataclass
class Service:
    """A rig that says its numbers in order, and notes what it is asked for."""

    offered: RequestMenu
    tables: Tables = field(default_factory=lambda: Tables({"a": 1}, capacity=1000))
    acted: list[Request] = field(default_factory=list)

    def greeting(self) -> dict[str, Any]:
        return {"rig": "toy"}

    def collect(self) -> None:
        self.tables.tables["a"].add([self.tables.tables["a"].count])

    def frame(self, cursor: Cursor) -> bytes:
        return self.tables.frame(cursor)

    async def act(self, request: Request) -> str:
        self.acted.append(request)
        return "done"


@pytest.fixture
def service(rig: Rig) -> Service:
    return Service(RequestMenu.of(rig, ("constant",)))


@pytest.fixture
def server(service: Service) -> Iterator[Server]:
    made = Server(service, port=0, pictures=50.0)
    made.start()
    yield made
    made.close()


@pytest.fixture
def page(server: Server) -> Iterator[Callable[..., ClientConnection]]:
    """Open a page's websocket; none is left open."""
    opened = ExitStack()

    def make(query: str | None = None, **options: Any) -> ClientConnection:
        query = f"token={server.token}" if query is None else query
        options.setdefault("origin", f"http://127.0.0.1:{server.port}")
        made = opened.enter_context(connect(f"ws://127.0.0.1:{server.port}/live?{query}", **options))
        assert json.loads(made.recv(timeout=PATIENCE)) == {"rig": "toy"}
        return made

    with opened:
        yield make


def picture(page: ClientConnection) -> list[float]:
    """The rows that the next frame brings."""
    page.send('{"do": "next"}')
    data = page.recv(timeout=PATIENCE)
    assert isinstance(data, bytes)
    _, arrays = unpacked(data)
    return arrays["a"][:, 0].tolist() if arrays else []


def answer(page: ClientConnection, text: str | bytes) -> dict[str, Any]:
    page.send(text)
    found: dict[str, Any] = json.loads(page.recv(timeout=PATIENCE))
    return found


def get(server: Server, path: str, **headers: str) -> tuple[int, bytes, http.client.HTTPMessage]:
    connection = http.client.HTTPConnection("127.0.0.1", server.port, timeout=PATIENCE)
    connection.putrequest("GET", path, skip_host=True)
    for name, value in {"Host": f"127.0.0.1:{server.port}", **headers}.items():
        connection.putheader(name, value)
    connection.endheaders()
    found = connection.getresponse()
    return found.status, found.read(), found.headers


def reported(server: Server, data: bytes) -> bytes:
    """What comes back for bytes that no client would send."""
    with socket.create_connection(("127.0.0.1", server.port), timeout=PATIENCE) as foreigner:
        foreigner.sendall(data)
        found = b""
        while block := foreigner.recv(65536):
            found += block
    return found


def test_the_page_and_all_that_it_loads_are_there(server: Server) -> None:
    for path in FILES:
        status, body, headers = get(server, f"{path}?token={server.token}")
        assert status == 200
        assert body
        assert "default-src 'none'" in headers["Content-Security-Policy"]
        assert "unsafe" not in headers["Content-Security-Policy"]


def test_the_page_loads_nothing_from_elsewhere(server: Server) -> None:
    for path in FILES:
        _, body, _ = get(server, f"{path}?token={server.token}")
        lines = [line for line in body.splitlines() if b"://" in line and b"w3.org" not in line]
        assert not [line for line in lines if b"src=" in line or b"import" in line or b"url(" in line]


@pytest.mark.parametrize("query", ["", "?token=", "?token=guess", "?token=%80", "?tok&&&&&&&&&", "?token=a&token=b"])
def test_without_the_token_there_is_no_rig(query: str, server: Server, page: Any) -> None:
    """The files of the page are the package's, and tell nothing of it."""
    assert get(server, f"/{query}")[1] == get(server, f"/?token={server.token}")[1]
    with pytest.raises(InvalidStatus) as refused:
        page(query.removeprefix("?"))
    assert refused.value.response.status_code == 403
    assert b"token" in (refused.value.response.body or b"")


@pytest.mark.parametrize(
    "host", ["evil.example", "evil.example:{port}", "127.0.0.1", "127.0.0.1:1", "[::1]:{port}", ""]
)
def test_another_host_is_refused(host: str, server: Server) -> None:
    """A name of somebody's that was made to point here (DNS rebinding)."""
    status, _, _ = get(server, f"/?token={server.token}", Host=host.format(port=server.port))
    assert status == 403


@pytest.mark.parametrize(
    "origin", [None, "null", "http://evil.example", "https://127.0.0.1:{port}", "http://127.0.0.1"]
)
def test_a_page_of_another_origin_is_refused(origin: str | None, server: Server, page: Any) -> None:
    with pytest.raises(InvalidStatus) as refused:
        page(origin=origin and origin.format(port=server.port))
    assert refused.value.response.status_code == 403


@pytest.mark.parametrize(
    "path",
    [
        "/../../../../etc/passwd",
        "/%2e%2e/%2e%2e/etc/passwd",
        "//etc/passwd",
        "/page.js/../server.py",
        "/page/index.html",
        "/server.py",
        "/index.html",
        "/live/../page.js",
        "/page.js%00.html",
        "http://evil.example/",
        "*",
    ],
)
def test_no_path_leads_out_of_the_page(path: str, server: Server) -> None:
    request = f"GET {path} HTTP/1.1\r\nHost: 127.0.0.1:{server.port}\r\n\r\n".encode()
    found = reported(server, request)
    assert found.split(b" ", 2)[1] in (b"404", b"400")
    assert b"root:" not in found
    assert b"import" not in found


@pytest.mark.parametrize("verb", ["POST", "PUT", "DELETE"])
def test_nothing_can_be_uploaded(verb: str, server: Server, service: Service) -> None:
    head = f"{verb} /page.js?token={server.token} HTTP/1.1\r\nHost: 127.0.0.1:{server.port}\r\n"
    assert b" 200 " not in reported(server, f"{head}Content-Length: 4\r\n\r\nevil".encode())[:20]
    assert not service.acted


def test_only_this_computer_is_served(server: Server) -> None:
    with pytest.raises(ConnectionRefusedError), socket.create_connection(("127.0.0.2", server.port), timeout=1.0):
        pass


def test_nonsense_gets_a_line_and_the_next_request_is_heard(page: Any, service: Service, server: Server) -> None:
    mine, other = page(), page()
    before = picture(other)
    texts: list[str | bytes] = [*NONSENSE, b"\x00\x01"]
    for text in texts:
        found = answer(mine, text)
        assert not found["done"]
        assert found["line"]
    assert not service.acted
    assert server.refused == len(NONSENSE) + 1
    assert answer(mine, '{"do": "policy", "policy": "exact", "id": 9}') == {"answer": 9, "done": True, "line": "done"}
    assert len(service.acted) == 1
    assert picture(other)[0] == before[-1] + 1


def test_who_sends_nothing_but_nonsense_is_shown_the_door(page: Any, server: Server) -> None:
    mine, other = page(), page()
    for _ in range(REFUSALS):
        assert not answer(mine, "nonsense")["done"]
    with pytest.raises(ConnectionClosed) as closed:
        mine.recv(timeout=PATIENCE)
    assert closed.value.rcvd is not None
    assert "no sense" in closed.value.rcvd.reason
    assert picture(other)


def test_what_is_too_large_closes_the_page_that_sent_it(page: Any) -> None:
    mine, other = page(), page()
    with pytest.raises(ConnectionClosed) as closed:
        answer(mine, "x" * (1 << 20))
    assert closed.value.rcvd is not None
    assert closed.value.rcvd.code == 1009
    assert picture(other)


def test_a_page_that_is_opened_twice_or_anew_is_shown_all(page: Any) -> None:
    one, two = page(), page()
    first = picture(one)
    second = picture(two)
    assert second[: len(first)] == first
    one.close()
    again = page()
    assert picture(again)[: len(second)] == second
    assert picture(two)[0] == second[-1] + 1


def test_a_slow_page_misses_nothing_and_holds_nobody_up(page: Any) -> None:
    slow, quick = page(), page()
    seen = picture(slow)
    for _ in range(10):
        picture(quick)
    behind = picture(slow)
    assert behind[0] == seen[-1] + 1
    assert len(behind) >= 10
    assert behind == list(range(int(behind[0]), int(behind[-1]) + 1))


def test_pictures_come_no_faster_than_was_said(page: Any) -> None:
    mine = page()
    picture(mine)
    began = time.monotonic()
    for _ in range(10):
        picture(mine)
    assert time.monotonic() - began > 9 / 50.0 * 0.9


def test_too_many_pages_are_refused(page: Any) -> None:
    opened = [page() for _ in range(PAGES)]
    with pytest.raises(InvalidStatus) as refused:
        page()
    assert refused.value.response.status_code == 503
    assert picture(opened[0])


def test_a_port_that_is_taken_is_reported(server: Server, service: Service) -> None:
    with pytest.raises(UserError, match=f"port {server.port}: .*--port"):
        Server(service, port=server.port, pictures=10.0).start()


def test_a_server_proves_that_it_knows_the_token(server: Server) -> None:
    nonce = "0123456789abcdef" * 2
    status, body, _ = get(server, f"/proof?nonce={nonce}")
    assert status == 200
    assert body.decode() == hmac.new(server.token.encode(), nonce.encode(), "sha256").hexdigest()
    assert get(server, f"/proof?nonce={nonce}", Host="evil.example")[0] == 403


@pytest.mark.parametrize("query", ["", "nonce=", "nonce=zz", "nonce=" + "0" * 33, "nonce=" + "0" * 32 + "&more=1"])
def test_a_proof_is_of_a_nonce_and_of_nothing_else(query: str, server: Server) -> None:
    assert get(server, f"/proof?{query}")[0] == 400


def test_tokens_differ(server: Server, service: Service) -> None:
    assert Server(service, port=0, pictures=10.0).token != server.token
    assert len(server.token) >= 20
