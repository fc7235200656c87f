"""The sidecar process: `python -I -m rossec.sidecar`, executed by `rossec run`.

Separate from the command line, whose imports would double its memory. Arguments come as one JSON
object from `rossec.cli.node.run`; they hold no secret.
"""

import asyncio
import json
import logging
import os
import signal
import sys
from typing import Any

from ca.errors import HintedError
from rossec.channel.suite_selection import post_quantum
from rossec.discovery.choose import discover_master
from rossec.environment import own_home, own_master
from rossec.log_limits import LogRateLimit
from rossec.net.host.own_address import warn_of_own_address
from rossec.ros import settings
from rossec.ros.text import printable
from rossec.sidecar import child, loopback_port
from rossec.sidecar.callers import Callers
from rossec.sidecar.descriptors import raise_limit
from rossec.sidecar.server import Sidecar

_REFUSED = 1
_log = logging.getLogger("rossec.sidecar")


def main() -> int:
    """Run with the arguments; return the exit code."""
    _restore_sigint()
    options = json.loads(sys.argv[1])
    logging.basicConfig(
        level=logging.INFO if options["verbose"] else logging.WARNING,
        format="rossec: %(levelname)s: %(message)s",
    )
    if not options["verbose"]:
        for handler in logging.getLogger().handlers:
            handler.addFilter(LogRateLimit())
    try:
        return asyncio.run(_run(options))
    except child.NoSuchProgram as error:
        return _fail(error, error.code)
    except HintedError as error:
        return _fail(error, _REFUSED)
    except OSError as error:
        sys.stderr.write(f"rossec: error: {printable(error)}\n")
        return _REFUSED


def _restore_sigint() -> None:
    """End on Ctrl-C as other processes do; `rossec run` has blocked the signal until now."""
    if signal.getsignal(signal.SIGINT) is not signal.SIG_IGN:
        signal.signal(signal.SIGINT, signal.SIG_DFL)
    signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGINT})


async def _run(options: dict[str, Any]) -> int:
    limits = raise_limit()
    before = await discover_master(child.outer_environment(os.environ), options["identity"])
    callers = _callers(options)
    sidecar = Sidecar(
        own_home(before),
        settings.read((), before, default_name="/sidecar"),
        callers,
        identity=options["identity"],
        each=options["each"],
        port=options["port"],
        suites=post_quantum(before),
        master_name=own_master(before),
    )
    sidecar.start()
    warn_of_own_address(settings.own_address(before), before, _warn_of_address)
    try:
        if options["command"]:
            child.adopt_orphans()
            environ = child.program_environment(os.environ, before, sidecar.uri, callers.loopback)
            return await child.run(options["command"], environ, limits)
        return await _serve(sidecar)
    finally:
        await sidecar.close()


def _warn_of_address(error: HintedError) -> None:
    _log.warning("%s (%s)", error, error.hint)


def _callers(options: dict[str, Any]) -> Callers:
    if options["command"]:
        return Callers({os.getuid()}, os.getpid(), loopback_port.find_loopback())
    return Callers(options["users"] or {os.getuid()}, None, loopback_port.find_loopback())


async def _serve(sidecar: Sidecar) -> int:
    stop = asyncio.Event()
    for number in (signal.SIGINT, signal.SIGTERM):
        asyncio.get_running_loop().add_signal_handler(number, stop.set)
    sys.stdout.write(f"sidecar at {sidecar.uri}\n")
    sys.stdout.flush()
    await stop.wait()
    return 0


def _fail(error: HintedError, code: int) -> int:
    sys.stderr.write(f"rossec: error: {printable(error)}\n")
    if error.hint:
        sys.stderr.write(f"rossec: hint: {printable(error.hint)}\n")
    return code


if __name__ == "__main__":
    sys.exit(main())
