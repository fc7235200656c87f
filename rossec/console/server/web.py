"""The web process: serves pages to browsers, and has nothing that signs, records or starts.

`python -I -m rossec.console.server.web`, started by `web_process`. It talks to strangers, so it is
confined before the first byte comes: it opens no file but programs' own, starts no process, and the
service's key socket refuses it. What it may do is what `console.sock` offers. It ends when the
supervisor does.
"""

import asyncio
import logging
import socket
import ssl
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Final

from rossec.authority.console.client import ConsoleClient
from rossec.authority.keyservice import messages
from rossec.console.app import create_app
from rossec.console.context import ConsoleContext
from rossec.console.preview.client import PreviewClient
from rossec.console.scanning.client import ScannerClient
from rossec.console.server import control
from rossec.console.server.serving import ConsoleServer
from rossec.console.settings import Settings, read_settings
from rossec.console.tls.server_context import load, make_context
from rossec.errors import ConfigurationError
from rossec.operation.confinement import confine_files, confine_processes
from rossec.operation.json_log import log_as_json
from rossec.operation.process_memory import protect_memory

_log: Final = logging.getLogger("rossec.console")


class WebProcess:
    """What runs in it.

    Args:
        settings: of the console.
        client: of the authority's service.
        scanner: the end of a socketpair behind which pictures are read.
        context: for TLS; None: plain HTTP.
        preview: the end of a socketpair from which messages come; None: pictures are made up.
    """

    def __init__(
        self,
        settings: Settings,
        client: ConsoleClient,
        scanner: socket.socket,
        context: ssl.SSLContext | None = None,
        preview: socket.socket | None = None,
    ) -> None:
        self._client, self._tls = client, context
        self._scanner = ScannerClient(scanner)
        self._preview = None if preview is None else PreviewClient(preview)
        self._context = ConsoleContext(client, settings, self._scanner, self._preview)
        self._server = ConsoleServer(
            create_app(self._context), context, settings.proxy_users, settings.users
        )

    async def run(self, supervisor: socket.socket, listening: Sequence[socket.socket]) -> None:
        """Serve until the supervisor ends its end of the socketpair.

        Raises:
            KeyMessageRefused, ConfigurationError: the supervisor breaks the protocol.
        """
        reader, writer = await asyncio.open_connection(sock=supervisor)
        try:
            if self._tls is not None:
                await self._obey(reader)  # the first certificate
            await self._server.start(listening)
            if self._preview is not None:
                self._preview.start()
            writer.write(control.write(control.ControlMessage(control.READY)))
            await writer.drain()
            while True:
                await self._obey(reader)
        except (asyncio.IncompleteReadError, ConnectionError):
            return
        finally:
            writer.transport.abort()
            await self._close()

    async def _obey(self, reader: asyncio.StreamReader) -> None:
        head = await reader.readexactly(messages.HEAD)
        size = messages.frame_size(head, control.MAX_FRAME)
        match control.read(await reader.readexactly(size)):
            case control.ControlMessage(control.CERTIFICATE, (bytes() as bundle,)) if (
                self._tls is not None
            ):
                load(self._tls, bundle)
            case other:
                raise ConfigurationError(f"the supervisor says {other.word}, which is not for here")

    async def _close(self) -> None:
        await self._server.close()
        await self._context.news.close()
        await self._context.enrollments.close()
        await self._scanner.close()
        if self._preview is not None:
            await self._preview.close()
        await self._client.close()


def main(arguments: list[str]) -> None:
    """Run it.

    Arguments: descriptors (supervisor, scanner, perhaps the preview, those that listen), settings,
    path of the service, `plain` or `tls`, form of the log, `preview` or `made-up`.
    """
    descriptors, settings, service, tls, log, pictures = arguments
    if log == "json":
        log_as_json()
    else:  # as the service itself writes, whose terminal or journal this is
        logging.basicConfig(level=logging.WARNING, format="rossec: %(levelname)s: %(message)s")
    protect_memory()
    confine_files([])
    executor = confine_processes()
    supervisor, scanner, *listening = (
        socket.socket(fileno=int(each)) for each in descriptors.split(",")
    )

    async def run() -> None:
        asyncio.get_running_loop().set_default_executor(executor)
        context = make_context() if tls == "tls" else None
        client = ConsoleClient(Path(service))
        preview = listening.pop(0) if pictures == "preview" else None
        process = WebProcess(read_settings(settings), client, scanner, context, preview)
        await process.run(supervisor, listening)

    asyncio.run(run())


if __name__ == "__main__":
    main(sys.argv[1:])
