"""The process that hands the TLS authority's certificate out, and ends by itself. A shell.

`python -I -m rossec.console.tls.hand_out_process`: it talks to whoever is on the network, so it is
confined as the web process is, and has nothing but the certificate. It is not the web process: that
one never speaks plain HTTP to the network.
"""

import asyncio
import logging
import socket
import subprocess
import sys
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from typing import BinaryIO, Final

from rossec.console.listening import listen_tcp
from rossec.console.options import HAND_OUT_PORT
from rossec.console.server.serving import ConsoleServer
from rossec.console.tls.hand_out import SECONDS, create_hand_out
from rossec.operation.confinement import confine_files, confine_processes

MODULE: Final = "rossec.console.tls.hand_out_process"
END: Final = 5.0  # seconds until it is killed


@contextmanager
def handing_out(
    certificate: bytes,
    origin: str,
    addresses: tuple[str, ...],
    environ: Mapping[str, str],
    port: int = HAND_OUT_PORT,
    seconds: float = SECONDS,
) -> Iterator[None]:
    """Hand `certificate` (DER) out at `port` for `seconds`, or until this is left.

    `origin` is the console's, where a reader goes afterwards.

    Raises:
        ConfigurationError: the port is used by another program.
    """
    listening = listen_tcp(addresses, port)
    descriptors = [sock.fileno() for sock in listening]
    arguments = [",".join(map(str, descriptors)), origin, str(seconds), certificate.hex()]
    process = subprocess.Popen(  # noqa: S603 - this program's own module
        [sys.executable, "-I", "-m", MODULE, *arguments],
        stdin=subprocess.PIPE,  # its end tells that the supervisor has ended
        stdout=subprocess.DEVNULL,
        pass_fds=descriptors,
        env=dict(environ),
        start_new_session=True,  # Ctrl-C is for the supervisor
    )
    for sock in listening:
        sock.close()
    try:
        yield
    finally:
        _end(process)


def _end(process: subprocess.Popen[bytes]) -> None:
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
    """Hand `data` out for `seconds`, or until the pipe `until` ends."""
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
    confine_files([])
    executor = confine_processes()
    listening = [socket.socket(fileno=int(each)) for each in descriptors.split(",")]

    async def run() -> None:
        asyncio.get_running_loop().set_default_executor(executor)
        await serve(listening, origin, float(seconds), bytes.fromhex(data), sys.stdin.buffer)

    asyncio.run(run())


if __name__ == "__main__":
    main(sys.argv[1:])
