"""The supervisor's side of the preview: starts its process beside each web process. A shell.

The two talk over a socketpair of their own, which the supervisor gives away: it reads no message.
"""

import asyncio
import logging
import socket
import subprocess
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Final

from rossec import clock
from rossec.console.preview.receiver import NAME
from rossec.errors import ConfigurationError
from rossec.home import NodeHome

MODULE: Final = "rossec.console.preview.receiver"
_END: Final = 5.0  # seconds between the end of the connection and SIGKILL
_log = logging.getLogger("rossec.console")


def check_enrolled(home: Path) -> None:
    """Return if the node `/console` has an identity in ROSSEC_HOME `home`.

    Raises:
        HintedError: it has none, or one that has expired.
    """
    node = NodeHome.of(home, NAME)
    if not (node.path / "node.pem").exists():
        raise ConfigurationError(
            f"--preview receives as the node {NAME}, which is not enrolled here",
            f"rossec node request {NAME}, rossec ca sign FILE, rossec node install FILE;"
            f" then grant it what pages may show: rossec grant sign {NAME} --subscribe TOPIC",
        )
    node.identity(clock.now())


class PreviewProcess:
    """The process of the preview; one at a time.

    Args:
        environ: of the node.
        module: that is run.
    """

    def __init__(self, environ: Mapping[str, str], module: str = MODULE) -> None:
        self._environ = dict(environ)
        self._command = (sys.executable, "-I", "-m", module)
        self._process: subprocess.Popen[bytes] | None = None

    @property
    def pid(self) -> int | None:
        """The process that runs now."""
        return None if self._process is None else self._process.pid

    def start(self) -> socket.socket:
        """Start it; returns the end of its socketpair that is for the pages."""
        theirs, pages = socket.socketpair()
        with theirs:
            self._process = subprocess.Popen(  # noqa: S603 - this program's own module
                [*self._command, str(theirs.fileno())],
                stdin=subprocess.DEVNULL,
                stdout=subprocess.DEVNULL,
                pass_fds=[theirs.fileno()],
                env=self._environ,
                start_new_session=True,  # Ctrl-C is for the supervisor, which ends it
            )
        return pages

    async def end(self) -> None:
        """Reap it: it ends with the connection, or is killed."""
        process, self._process = self._process, None
        if process is None:
            return
        try:
            await asyncio.to_thread(process.wait, _END)
        except subprocess.TimeoutExpired:
            _log.warning("the preview does not end; it is killed")
        finally:
            process.kill()
            process.wait()
