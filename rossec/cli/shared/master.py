"""The master of a command: where it is, and a connection or a node there; and files with grants.

All commands take the master's URI from here, from `--master` or ROS_MASTER_URI. Where it is
`discover:`, the master is found once, by what it announces (docs/howto/find-the-master.md).
A grant of the node's own domain, or of a listed one, is verified. Of one of another domain that is
checked which the node can know: its form, its time and its key.
"""

import contextlib
from collections.abc import AsyncIterator, Mapping
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Final

from ca.names import origin_of, shown
from grants.errors import GrantNotHeld
from grants.model import Grant, check_time
from grants.token import MAX_TOKEN, Verifier, peek
from rossec import files
from rossec.channel.edhoc.credentials import Credentials
from rossec.channel.opening import post_quantum
from rossec.cli.shared.context import Environment
from rossec.errors import ChannelClosed, ConfigurationError, MasterNotFound
from rossec.home import NodeHome
from rossec.host import addresses
from rossec.host.addresses import warn_of_own_address
from rossec.ros import names
from rossec.saved_statements import DomainFiles
from rossec.terminal import note

if TYPE_CHECKING:
    from rossec.net.rpc import RpcClient
    from rossec.node import Node
    from rossec.participant.renewals import MasterCall

VARIABLE: Final = "ROS_MASTER_URI"
DISCOVER: Final = "discover:"
REVOCATIONS: Final = "rossec.revocations"
SETTLE: Final = 1.0  # seconds: two announcements; a command that ends at once measures no loss


def master_at(environment: Environment, node: str | NodeHome | None, master_uri: str | None = None) -> str:
    """As `find_master`, outside of a loop."""
    uri = _given(environment, master_uri)
    if uri != DISCOVER:
        return uri
    import asyncio  # noqa: PLC0415 - most commands have no loop

    return asyncio.run(find_master(environment, node, master_uri))


def _given(environment: Environment, master_uri: str | None) -> str:
    return master_uri or environment.variables.get(VARIABLE, names.DEFAULT_MASTER_URI)


async def find_master(
    environment: Environment, node: str | NodeHome | None, master_uri: str | None = None
) -> str:
    """The master's URI: `master_uri` (of `--master`), or ROS_MASTER_URI, or ROS's default.

    `node` is the name or directory of who will call it, for `discover:`; None: any node of the home,
    if all of them trust the same authority.
    """
    uri = _given(environment, master_uri)
    if uri != DISCOVER:
        return uri
    from rossec.discovery import discover_master, trusted  # noqa: PLC0415 - imported where it is asked for

    who = f"/{node.lstrip('/')}" if isinstance(node, str) else node
    # Kept for this command and no longer: a robot that moves would ask the wrong master (decision 0044).
    key = trusted(environment.home, who)[0].thumbprint
    if key not in environment.found:
        looked = {**environment.variables, VARIABLE: DISCOVER}
        try:
            environment.found[key] = (await discover_master(looked, who, SETTLE))[VARIABLE]
        except MasterNotFound as error:
            environment.found[key] = error
    found = environment.found[key]
    if isinstance(found, MasterNotFound):
        raise found
    return found


@contextlib.asynccontextmanager
async def node_as(environment: Environment, name: str) -> AsyncIterator["Node"]:
    from rossec.node import Node  # noqa: PLC0415 - commands without a node do not need it

    async with Node(name, environ=await with_master(environment, name)) as node:
        yield node


async def with_master(environment: Environment, node: str | NodeHome | None) -> Mapping[str, str]:
    """The variables of the environment, for what reads ROS_MASTER_URI itself."""
    return {**environment.variables, VARIABLE: await find_master(environment, node)}


def own_variables(environment: Environment) -> Mapping[str, str]:
    """The variables of the environment, for a master: ROS_MASTER_URI has its own port.

    `discover:` says where others find it, so that it listens at ROS's default.
    """
    if _given(environment, None) != DISCOVER:
        return environment.variables
    return {**environment.variables, VARIABLE: names.DEFAULT_MASTER_URI}


@contextlib.asynccontextmanager
async def calls_as(
    environment: Environment, home: NodeHome, uri: str, own: Credentials | None = None
) -> AsyncIterator["MasterCall"]:
    """A connection on which the node has presented its grants; yields what calls over it."""
    async with master_as(environment, home, uri, own) as client:

        async def call(method: str, *parameters: object) -> object:
            return await client.ask(method, home.name, *parameters)

        await call(names.PRESENT_GRANTS, home.grants())
        yield call


@contextlib.asynccontextmanager
async def master_as(
    environment: Environment, home: NodeHome, uri: str, own: Credentials | None = None
) -> AsyncIterator["RpcClient"]:
    """A connection to the master at `uri`, with the identity in `home`, or `own` instead."""
    from rossec.authority.master_connection import master_connection  # noqa: PLC0415 - most call no master

    credentials = home.credentials() if own is None else own
    suites = post_quantum(environment.variables)
    connection = partial(master_connection, credentials, home.anchor(), uri, suites)
    try:
        async with connection() as client:
            yield client
    except ChannelClosed as error:  # as masters answer a revoked identity, but for one call
        async with connection() as client:
            if is_of_revoked(await client.ask(REVOCATIONS, home.name)):
                raise ConfigurationError(revoked_text(home.name), anew(home)) from error
        raise


def is_of_revoked(answer: object) -> bool:
    match answer:
        case [bytes() as data, b""]:
            return bool(data)
        case _:
            return False


def revoked_text(name: str) -> str:
    return f"the master says that this identity is revoked: {name}"


def anew(home: NodeHome) -> str:
    return f"move {home.path} away and enroll it anew: rossec node request {home.name}"


def own_address(environment: Environment) -> str:
    """ROS_IP or ROS_HOSTNAME, else the address at which others probably reach this host."""
    configured = names.own_address(environment.variables)
    if configured is not None:
        warn_of_own_address(configured, environment.variables, lambda error: note(f"{error} ({error.hint})"))
        return configured
    first, *others = addresses.own_addresses()
    if others:
        note(f"other addresses of this host, for --address: {', '.join(others)}")
    return first


def read_token(path: Path) -> bytes:
    """The octets of a file with a token; not verified."""
    missing = ConfigurationError(f"there is no file {path}", "give the file `rossec grant` wrote")
    return files.read(path, MAX_TOKEN, missing)


def holder_home(rossec_home: Path, grant: Grant) -> NodeHome:
    """The directory of the node a grant is for: a grant of another domain names it by its alias."""
    return NodeHome.of(rossec_home, origin_of(grant.subject))


def open_held(home: NodeHome, token: bytes, now: int) -> Grant:
    """What a token of this node says, verified as far as this node can."""
    anchor, grant = home.anchor(), peek(token)
    listed = DomainFiles(home, anchor).anchors().listed_domain(grant.domain)
    if grant.domain == anchor.domain or listed is not None:
        signer = anchor if listed is None else listed.anchor
        Verifier(signer.public_key, signer.domain, (), 0, lambda _entry, _now: None).open(token, now)
    check_time(grant, now)
    if grant.holder != home.identity(now).thumbprint:
        raise GrantNotHeld(
            f"grant {grant.short_id} is bound to another key than that of {home.name}",
            f"the domain {grant.domain} gave it to {shown(grant.subject)}: install it there",
        )
    return grant
