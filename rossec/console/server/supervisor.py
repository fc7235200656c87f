"""The console as a command: sockets that listen, the web process behind them, its end. A shell.

It has what the web process must not have: the terminal, and the right to start processes. It reads
nothing that browsers send; pictures go on to the scanner's process unread.
"""

import os
import pwd
from collections.abc import Callable, Mapping

from rossec.console.listening import listen
from rossec.console.options import Endpoint
from rossec.console.preview.supervisor import PreviewProcess
from rossec.console.server.web_process import Certificates, WebOptions, WebProcess
from rossec.console.settings import IDLE, LIFETIME, ON_THE_WALL, Settings
from rossec.errors import ConfigurationError
from rossec.operation.shutdown import stop_on_signals, until_first_ends


def settings_for(endpoint: Endpoint, domain: str) -> Settings:
    """The web process's settings: on localhost only this user's programs may connect.

    Raises:
        ConfigurationError: there is no such user as the proxy's.
    """
    own, is_localhost = frozenset({os.geteuid()}), endpoint.is_local and not endpoint.unix_path
    return Settings(
        domain,
        (endpoint.origin,),
        users=own if is_localhost else None,
        proxy_users=own | _users(endpoint.proxy_user) if endpoint.unix_path else frozenset(),
        hsts=endpoint.hsts,
        read_only=endpoint.read_only,
        lifetime=ON_THE_WALL if endpoint.read_only else LIFETIME,
        idle=ON_THE_WALL if endpoint.read_only else IDLE,
    )


def _users(name: str | None) -> frozenset[int]:
    if name is None:
        return frozenset()
    try:
        return frozenset({pwd.getpwnam(name).pw_uid})
    except KeyError:
        raise ConfigurationError(
            f"there is no user {name!a} on this host", "--proxy-user is the user of the proxy"
        ) from None


async def supervise(
    endpoint: Endpoint,
    options: WebOptions,
    environ: Mapping[str, str],
    ready: Callable[[], None],
    certificates: Certificates | None = None,
    preview: PreviewProcess | None = None,
) -> None:
    """Run the console until SIGINT or SIGTERM; `ready` is called when it serves.

    Raises:
        ConfigurationError: it cannot listen, or its web process does not start.
    """
    stop = stop_on_signals()
    sockets = listen(endpoint)
    try:
        web = WebProcess(options, sockets, environ, certificates, preview=preview)

        async def until_stopped() -> None:
            await web.started()
            ready()
            await stop.wait()

        await until_first_ends(web.run(), until_stopped(), stop.wait())
    finally:
        for sock in sockets:
            sock.close()
        _remove_path(endpoint)


def _remove_path(endpoint: Endpoint) -> None:
    if endpoint.unix_path is not None:
        endpoint.unix_path.unlink(missing_ok=True)
