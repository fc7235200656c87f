"""`/news`: a stream for who has a session, over a real connection."""

import asyncio
from pathlib import Path

from starlette.requests import Request
from starlette.responses import StreamingResponse

from rossec.console.pages.today import stream
from rossec.console.rendering import Visit
from tests.support.consolepages import Browser
from tests.support.consoleprocess import ask, running_web


def test_a_script_without_a_session_is_told() -> None:
    answer = Browser().get("/news", headers={"Accept": "text/event-stream"})
    assert answer.status_code == 401


async def test_a_stream_is_of_its_session() -> None:
    browser = Browser().log_in()
    context = browser.context
    session = context.sessions.find(browser.headers["Cookie"].partition("=")[2], browser.now)
    assert session is not None
    request = Request({"type": "http", "query_string": b"", "headers": [], "state": {"session": session}})
    answer = await stream(Visit(request, context))
    assert isinstance(answer, StreamingResponse)
    assert answer.media_type == "text/event-stream"
    context.sessions.end(session)
    assert [piece async for piece in answer.body_iterator] == [b":\n\n"]
    await context.news.close()


async def test_a_change_reaches_an_open_page_and_logging_out_ends_it(tmp_path: Path) -> None:
    async with running_web(tmp_path) as running:
        form = {"Origin": running.origin, "Content_Type": "application/x-www-form-urlencoded"}
        code = f"code={running.home.add_code()}"
        answer = await ask(running, "/login", "POST", code, **form)
        cookie = answer.headers["set-cookie"].partition(";")[0]
        reader, writer = await asyncio.open_connection("127.0.0.1", running.port)
        host = running.origin.removeprefix("http://")
        head = f"GET /news HTTP/1.1\r\nHost: {host}\r\nCookie: {cookie}\r\n\r\n"
        writer.write(head.encode())
        async with asyncio.timeout(20):
            assert b"200 OK" in await reader.readuntil(b"\r\n\r\n")
            await reader.readuntil(b"data: 1.0")
            running.home.number = 7
            await reader.readuntil(b"data: 7.0")
            await ask(running, "/logout", "POST", "", Cookie=cookie, Origin=running.origin)
            assert b"data: 7" not in await reader.readuntil(b"\n0\r\n\r\n")
        writer.transport.abort()
