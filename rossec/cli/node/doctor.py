"""`rossec doctor`: check whether a node is set up correctly, and what of it is unprotected.

Each check is one line, `ok` or `not ok` with what to do; the command fails when one is not ok. What
is revoked is not ok, wherever on this machine that is known, without a running master. Plain
connections that are allowed get a line of their own and are no failure: they were configured.
"""

import asyncio
from collections.abc import Iterator, Mapping

import click

from ca.domains.aliases import display_name, shown
from ca.errors import HintedError
from ca.names import is_master_name, is_relay_name
from ca.renewal import signed_at
from ca.revocation.state import Revocations, open_timestamp
from grants.model import Grant
from rossec import files
from rossec.channel.suite_selection import post_quantum
from rossec.cli.node.known_domains import check_domains
from rossec.cli.node.known_revocations import known_revocations
from rossec.cli.shared.context import Environment, now, pass_environment
from rossec.cli.shared.tokens import open_held
from rossec.clock import format_time
from rossec.environment import OWN_MASTER, own_master
from rossec.errors import ConfigurationError
from rossec.home import NodeHome
from rossec.inprocess.options import file_of, read
from rossec.net.aio import SecureContext, WireProtocol, connect
from rossec.net.rpc.client import RpcClient
from rossec.ros import settings
from rossec.saved_domains import DomainFiles
from rossec.terminal import printable, say

_SOON = 1 / 3  # of an identity's life: by then it should have been renewed
_MAX_FILE = 64 * 1024


@click.command()
@click.argument("name", metavar="NODE")
@click.option("--offline", is_flag=True, help="do not ask the master")
@pass_environment
def doctor(environment: Environment, name: str, offline: bool) -> None:
    """Check the set-up of NODE on this machine: identity, grants, master, what is plain."""
    home = NodeHome.find(environment.home, name)
    checks = [_identity, _grants, _domains] if offline else [_identity, _grants, _domains, _master]
    failed = 0
    for check in checks:
        try:
            for line in check(environment, home):
                say(f"ok      {printable(line)}")
        except HintedError as error:
            failed += 1
            say(f"not ok  {printable(str(error))}")
            say(f"        {printable(error.hint)}")
    for entry in _plain(environment):
        say(f"PLAIN   {printable(entry)} is neither encrypted nor checked: allow_plain names it")
    if failed:
        raise ConfigurationError(f"{failed} of {len(checks)} checks failed", "see above")


def _identity(environment: Environment, home: NodeHome) -> Iterator[str]:
    identity = home.identity(now())
    revoked = known_revocations(environment.home, home)
    for key in identity.keys:
        if key in revoked:
            which = "" if key == identity.thumbprint else "intermediate's "
            raise ConfigurationError(
                f"the {which}key of {identity.name} is revoked according to {revoked[key]}",
                f"move {home.path} away and enroll it anew: rossec node request {identity.name}",
            )
    yield f"{identity.name} of {identity.domain} until {format_time(identity.not_after)}"
    life = identity.not_after - signed_at(identity.not_before, identity.not_after)
    if identity.not_after - now() < life * _SOON:
        raise ConfigurationError("the identity ends soon, and was not renewed", "renew it in time")


def _grants(environment: Environment, home: NodeHome) -> Iterator[str]:
    held = home.grants()
    revoked, refused = known_revocations(environment.home, home), list[HintedError]()
    for data in held:
        try:
            grant = open_held(home, data, now())
            _check_grant(grant, revoked)
        except HintedError as error:
            refused.append(error)
            continue
        label = _label(home, grant)
        for permission in grant.links[-1].permissions:
            until = format_time(grant.expires)
            pattern = display_name(label, permission.pattern)
            yield f"may {permission.rights.label} {pattern} until {until}"
    if not held and is_relay_name(home.name):
        yield "no grants: a relay needs none"
    elif not held and is_master_name(home.name):
        yield "no grants: within its own domain a master needs none"
    elif not held:
        raise ConfigurationError("no grants: it may do nothing", f"rossec grant sign {home.name}")
    if refused:
        others = f" (and {len(refused) - 1} more)" if refused[1:] else ""
        raise ConfigurationError(f"{refused[0]}{others}", refused[0].hint)


def _label(home: NodeHome, grant: Grant) -> str:
    """What the domain of the grant is called here, empty for the own one."""
    anchor = home.anchor()
    listed = DomainFiles(home, anchor).anchors().listed_domain(grant.domain)
    if listed is not None:
        return listed.entry.label
    return "" if grant.domain == anchor.domain else grant.domain


def _check_grant(grant: Grant, revoked: Mapping[bytes, str]) -> None:
    for entry in (*grant.revocable, grant.holder):
        if entry in revoked:
            raise ConfigurationError(
                f"grant {grant.short_id} is revoked according to {revoked[entry]}",
                f"ask for another; it does no harm in {grant.subject}'s directory",
            )


def _domains(environment: Environment, home: NodeHome) -> Iterator[str]:
    yield from check_domains(environment.home, home, now())


def _master(environment: Environment, home: NodeHome) -> Iterator[str]:
    variables = environment.variables
    if home.name == own_master(variables):  # it would meet its own certificate
        yield "the master of this host: rossec master status"
        return
    own = settings.read((), variables, default_name=home.name)
    yield asyncio.run(_ask_master(home, own, post_quantum(variables), own_master(variables)))


async def _ask_master(
    home: NodeHome, own: settings.Settings, suites: tuple[int, ...], master: str
) -> str:
    anchor = home.anchor()
    anchors = DomainFiles(home, anchor).anchors()
    context = SecureContext(home.credentials(), anchors.verify, suites=suites)
    stream = await connect(own.master_host, own.master_port, context, WireProtocol.HTTP)
    try:
        if stream.peer.name != master:
            raise ConfigurationError(
                f"{shown(stream.peer.name)} answers there, not {master}",
                f"check ROS_MASTER_URI, and {OWN_MASTER} if there are several masters",
            )
        answer = await RpcClient(stream).ask("rossec.revocations", home.name)
    finally:
        await stream.close()
    match answer:
        case [bytes() as data, b""] if data:
            raise ConfigurationError(
                "the master says that this identity is revoked", "enroll the node with a new key"
            )
        case [bytes() as data, bytes() as timestamp] if data:
            revocations = Revocations(anchor.public_key)
            revocations.update(data, now())
            revocations.confirm(open_timestamp(timestamp, stream.peer.public_key), now())
            revocations.check(stream.peer.thumbprint, now())
            return f"the master at {own.master_uri} has a fresh revocation list"
        case _:
            raise ConfigurationError("the master has no revocation list", "next: rossec ca publish")


def _plain(environment: Environment) -> tuple[str, ...]:
    path = file_of(environment.variables)
    missing = ConfigurationError(f"{path} cannot be read")
    text = None
    if path.exists():  # as `rossec.secure` reads it
        text = files.read(path, _MAX_FILE, missing).decode(errors="replace")
    return read(environment.variables, text).allow_plain
