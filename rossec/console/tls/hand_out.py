"""Hands the TLS authority's certificate to a phone: plain HTTP, for ten minutes, in a process of its own.

It knows no state, reads no header and no body, and answers GET of two paths. The process (`python -I -m
rossec.console.tls.hand_out`) is confined as the web process is, which never speaks plain HTTP to the network,
has nothing but the certificate, and ends by itself.
"""

import asyncio
import html
import logging
import socket
import subprocess
import sys
import time
from base64 import b64encode
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from hashlib import sha256
from http import HTTPStatus
from importlib import resources
from string import Template
from typing import BinaryIO, Final, NamedTuple

from starlette.types import ASGIApp, Receive, Scope, Send

from rossec.console.listening import listen_tcp
from rossec.console.options import HAND_OUT_PORT
from rossec.console.server import ConsoleServer
from rossec.errors import ConfigurationError
from rossec.host.workers import run_confined, start_worker, worker_command

MODULE: Final = "rossec.console.tls.hand_out"
SECONDS: Final = 600
END: Final = 5.0  # seconds until it is killed
PAGE: Final = "/"
FILE: Final = "/rossec-console.crt"
_OTHERS: Final = (
    (b"x-content-type-options", b"nosniff"),
    (b"referrer-policy", b"no-referrer"),
    (b"cache-control", b"no-store"),
)


class Document(NamedTuple):
    media_type: str
    body: bytes
    policy: str  # Content-Security-Policy


def documents(certificate: bytes, origin: str) -> dict[str, Document]:
    """What is handed out: the page at `PAGE`, the certificate (DER) at `FILE`. Pure."""
    # The phone trusts nothing here yet: whoever is on the network can change the page. So it does not show
    # the fingerprint (an attacker's page would show the attacker's): the reader compares what the phone shows
    # with what the terminal shows.
    folder = resources.files(__package__)
    style, text = ((folder / name).read_text("utf-8") for name in ("hand_out.css", "hand_out.html"))
    values = {"origin": html.escape(origin), "file": FILE, "style": style}
    digest = b64encode(sha256(style.encode()).digest()).decode()
    policy = f"default-src 'none'; style-src 'sha256-{digest}'; base-uri 'none'; form-action 'none'"
    page = Template(text).substitute(values).encode()
    return {
        PAGE: Document("text/html; charset=utf-8", page, f"{policy}; frame-ancestors 'none'"),
        FILE: Document("application/x-x509-ca-cert", certificate, "default-src 'none'"),
    }


def create_hand_out(certificate: bytes, origin: str, is_over: Callable[[], bool]) -> ASGIApp:
    found = documents(certificate, origin)

    async def answer(scope: Scope, _receive: Receive, send: Send) -> None:
        if scope["type"] != "http":
            raise ConfigurationError("only HTTP is served here")
        document = found.get(scope["path"])
        status = HTTPStatus.OK if scope["method"] == "GET" else HTTPStatus.METHOD_NOT_ALLOWED
        status = HTTPStatus.NOT_FOUND if document is None else status
        status = HTTPStatus.GONE if is_over() else status
        if status is not HTTPStatus.OK or document is None:
            document = Document("text/plain", status.phrase.encode(), "default-src 'none'")
        headers = [
            (b"content-type", document.media_type.encode()),
            (b"content-length", str(len(document.body)).encode()),
            (b"content-security-policy", document.policy.encode()),
            *_OTHERS,
        ]
        await send({"type": "http.response.start", "status": status, "headers": headers})
        await send({"type": "http.response.body", "body": document.body})

    return answer


@contextmanager
def handing_out(
    certificate: bytes,
    origin: str,
    addresses: tuple[str, ...],
    environ: Mapping[str, str],
    port: int = HAND_OUT_PORT,
    seconds: float = SECONDS,
) -> Iterator[None]:
    """While it is entered, and for `seconds` at most, hand out the certificate (DER) at `addresses`."""
    listening = listen_tcp(addresses, port)
    descriptors = [sock.fileno() for sock in listening]
    arguments = [",".join(map(str, descriptors)), origin, str(seconds), certificate.hex()]
    command = [*worker_command(MODULE), *arguments]
    # The end of its standard input tells it that the supervisor has ended.
    process = start_worker(command, environ, descriptors, stdin=subprocess.PIPE)
    for sock in listening:
        sock.close()
    try:
        yield
    finally:
        if process.stdin is not None:
            process.stdin.close()
        try:
            process.wait(END)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()


async def serve(
    listening: list[socket.socket], origin: str, seconds: float, data: bytes, until: BinaryIO
) -> None:
    # Not by the host's clock, which can be set: it would hand out for longer, or not at all.
    end = time.monotonic() + seconds
    server = ConsoleServer(create_hand_out(data, origin, lambda: time.monotonic() > end))
    reader = asyncio.StreamReader()
    loop = asyncio.get_running_loop()
    transport, _ = await loop.connect_read_pipe(lambda: asyncio.StreamReaderProtocol(reader), until)
    await server.start(listening)
    try:
        async with asyncio.timeout(seconds):
            await reader.read()
    except TimeoutError:
        pass
    finally:
        transport.close()
        await server.close()


def main(arguments: list[str]) -> None:
    """Run it: descriptors that listen, the console's origin, seconds, the certificate in hex."""
    descriptors, origin, seconds, data = arguments
    logging.basicConfig(level=logging.WARNING)

    async def run() -> None:
        listening = [socket.socket(fileno=int(each)) for each in descriptors.split(",")]
        await serve(listening, origin, float(seconds), bytes.fromhex(data), sys.stdin.buffer)

    run_confined(run)


if __name__ == "__main__":
    main(sys.argv[1:])
