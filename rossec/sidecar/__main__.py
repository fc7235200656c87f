"""The sidecar process: `python -I -m rossec.sidecar`, executed by `rossec run`.

Separate from the command line, whose imports would double its memory. Arguments come as one JSON
object from `rossec.cli.node.sidecar`; they hold no secret.
"""

import asyncio
import json
import logging
import os
import signal
import sys
from typing import Any

from ca.errors import HintedError
from rossec.channel.opening import post_quantum
from rossec.discovery import discover_master
from rossec.environment import own_home, own_master
from rossec.host import addresses, local_ports, runner
from rossec.host.callers import Callers
from rossec.peer_limits import LogRateLimit, printable
from rossec.ros import names
from rossec.sidecar import child, server

_REFUSED = 1
_log = logging.getLogger("rossec.sidecar")


def main() -> int:
    if signal.getsignal(signal.SIGINT) is not signal.SIG_IGN:
        signal.signal(signal.SIGINT, signal.SIG_DFL)
    signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGINT})
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
    except (HintedError, OSError) as error:
        sys.stderr.write(f"rossec: error: {printable(error)}\n")
        if isinstance(error, HintedError) and error.hint:
            sys.stderr.write(f"rossec: hint: {printable(error.hint)}\n")
        return error.code if isinstance(error, child.NoSuchProgram) else _REFUSED


async def _run(options: dict[str, Any]) -> int:
    limits = child.raise_limit()
    before = await discover_master(child.outer_environment(os.environ), options["identity"])
    users, ancestor = options["users"] or {os.getuid()}, None
    if options["command"]:
        users, ancestor = {os.getuid()}, os.getpid()
    callers = Callers(users, ancestor, local_ports.find_loopback())
    sidecar = server.Sidecar(
        own_home(before),
        names.read((), before, default_name="/sidecar"),
        callers,
        identity=options["identity"],
        each=options["each"],
        port=options["port"],
        suites=post_quantum(before),
        master_name=own_master(before),
    )
    sidecar.start()
    addresses.warn_of_own_address(
        names.own_address(before), before, lambda error: _log.warning("%s (%s)", error, error.hint)
    )
    try:
        if options["command"]:
            child.adopt_orphans()
            environ = child.program_environment(os.environ, before, sidecar.uri, callers.loopback)
            return await child.run(options["command"], environ, limits)
        stop = runner.stop_on_signals()
        sys.stdout.write(f"sidecar at {sidecar.uri}\n")
        sys.stdout.flush()
        await stop.wait()
        return 0
    finally:
        await sidecar.close()


if __name__ == "__main__":
    sys.exit(main())
