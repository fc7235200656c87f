"""`rossec master`: run the ROS master of a trust domain."""

import asyncio
import signal
from pathlib import Path

import click

from ca.revocationtree import is_tree
from rossec.authority import AuthorityHome, OpenAuthority
from rossec.channel import policy
from rossec.cli import passphrase
from rossec.cli.context import Environment, now, pass_environment
from rossec.cli.delegate import delegate
from rossec.cli.voice import say, say_json
from rossec.errors import ConfigurationError
from rossec.home import NodeHome
from rossec.master.complaints import Complain, ComplainLog, unheard
from rossec.master.start import master_of
from rossec.node.slave import MASTER
from rossec.ros import settings


@click.group(invoke_without_command=True)
@click.option(
    "--port",
    "-p",
    type=click.IntRange(0, 65535),
    help="instead of the one in ROS_MASTER_URI; 0 for any",
)
@click.option("--json", "as_json", is_flag=True, help="say the address as a line of JSON")
@click.option(
    "--complaints",
    type=click.Path(path_type=Path, dir_okay=False),
    help="append what nodes lack the right to, for: rossec policy learn --from-log",
)
@click.option(
    "--renew-identities", is_flag=True, help="with the intermediate of this host: see rossec ca"
)
@passphrase.option
@click.option(
    "--post-quantum",
    metavar="POLICY",
    help="off, prefer or require; instead of ROSSEC_POST_QUANTUM",
)
@click.pass_context
@pass_environment
def master(
    environment: Environment,
    context: click.Context,
    port: int | None,
    as_json: bool,
    complaints: Path | None,
    renew_identities: bool,
    passphrase_file: Path | None,
    post_quantum: str | None,
) -> None:
    """Run the master, as the node /master. Ends with Ctrl-C."""
    if context.invoked_subcommand is not None:
        return
    log = ComplainLog(complaints) if complaints is not None else unheard
    renewer = _intermediate(environment, passphrase_file) if renew_identities else None
    suites = policy.post_quantum(environment.variables, post_quantum)
    asyncio.run(_serve(environment, port, as_json, log, suites, renewer))


master.add_command(delegate)


async def _serve(
    environment: Environment,
    port: int | None,
    as_json: bool,
    complain: Complain,
    suites: tuple[int, ...],
    intermediate: OpenAuthority | None,
) -> None:
    own = settings.read((), environment.variables, default_name=MASTER)
    stop = asyncio.Event()
    for number in (signal.SIGINT, signal.SIGTERM):
        asyncio.get_running_loop().add_signal_handler(number, stop.set)
    home = NodeHome.of(environment.home, MASTER)
    server = master_of(
        home,
        host=own.address,
        port=own.master_port if port is None else port,
        newest=_newest_list(environment),
        entries=_entries(environment),
        intermediate=intermediate,
        now=now(),
        complain=complain,
        suites=suites,
    )
    await server.start()
    try:
        if as_json:
            say_json({"ready": server.uri})
        else:
            say(f"master of {home.anchor().domain} at {server.uri}")
        asked = asyncio.ensure_future(server.stopped())
        signalled = asyncio.ensure_future(stop.wait())
        await asyncio.wait({asked, signalled}, return_when=asyncio.FIRST_COMPLETED)
        asked.cancel()
        signalled.cancel()
    finally:
        await server.close()


def _newest_list(environment: Environment) -> bytes | None:
    """The authority's own record, when it lives on this host."""
    if not (environment.home / "ca" / "ca.pem").exists():
        return None
    return AuthorityHome.at(environment.home).revocation_list()


def _entries(environment: Environment) -> bytes | None:
    """The entries of the authority's tree, when it lives on this host and needs one."""
    newest = _newest_list(environment)
    if newest is None or not is_tree(newest):
        return None
    return AuthorityHome.at(environment.home).entries()


def _intermediate(environment: Environment, file: Path | None) -> OpenAuthority:
    """The intermediate of this host, unlocked.

    Raises:
        ConfigurationError: there is none, or it is the root, whose key stays offline.
    """
    home = AuthorityHome.at(environment.home)
    authority = home.unlock(passphrase.read(file, environment.variables))
    if authority.authority.is_root:
        raise ConfigurationError(
            f"{home.path} holds the root, which signs no renewals for a master",
            "make an intermediate: rossec ca intermediate request",
        )
    return authority
