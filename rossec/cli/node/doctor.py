"""`rossec doctor`: check whether a node is set up correctly, and what of it is unprotected.

Each check is one line, `ok` or `not ok` with what to do; the command fails when one is not ok. What
is revoked is not ok, wherever on this machine that is known, without a running master. Plain
connections that are allowed get a line of their own and are no failure: they were configured.
"""

import asyncio
from collections import defaultdict
from collections.abc import Callable, Iterator, Mapping
from contextlib import suppress
from dataclasses import asdict, dataclass

import click

from ca.certificates import Identity
from ca.domains.aliases import display_name, shown
from ca.errors import HintedError, RevocationRefused
from ca.names import is_master_name, is_relay_name
from ca.renewal import signed_at
from ca.revocation.state import SKEW, open_statement
from grants.errors import GrantRevoked
from grants.missing_rights import in_shell
from grants.model import Grant
from rossec import files
from rossec.cli.node.address_check import Outcome, check_own_address
from rossec.cli.node.known_domains import check_domains
from rossec.cli.node.known_revocations import known_revocations
from rossec.cli.node.master_check import check_master
from rossec.cli.shared.context import Environment, now, pass_environment
from rossec.cli.shared.master import anew
from rossec.cli.shared.tokens import open_held
from rossec.clock import format_duration, format_time
from rossec.environment import own_master
from rossec.errors import ConfigurationError
from rossec.home import NodeHome
from rossec.home_hints import missing_nodes, nodes_in
from rossec.inprocess.options import file_of, read
from rossec.saved_domains import DomainFiles
from rossec.terminal import printable, say, say_json, state

_SOON = 1 / 3  # of an identity's life: by then it should have been renewed
_MAX_FILE = 64 * 1024


class IdentityRevoked(ConfigurationError):
    """This host knows that the identity of a node is revoked."""


Check = Callable[[Environment, NodeHome], Iterator[Outcome]]


@click.command()
@click.argument("names", metavar="[NODE]...", nargs=-1)
@click.option("--offline", is_flag=True, help="do not ask the master")
@click.option("--json", "as_json", is_flag=True, help="one line of JSON")
@pass_environment
def doctor(environment: Environment, names: tuple[str, ...], offline: bool, as_json: bool) -> None:
    """Check the set-up of NODE on this machine: identity, grants, master, what is plain.

    Without NODE every node of this machine; what several have in common is said once.
    """
    homes, unfinished = [NodeHome.find(environment.home, name) for name in names], list[str]()
    if not homes:
        homes, unfinished = _all(environment)
    findings = [
        finding for home in homes for finding in _examine(environment, home, offline=offline)
    ]
    plain = list(_plain(environment))
    if as_json:
        say_json({"findings": [asdict(finding) for finding in findings], "plain": plain,
                  "unfinished": unfinished})  # fmt: skip
    else:
        _say(findings, plain, several=len(homes) > 1)
        for name in unfinished:
            say(f"-       {shown(name)} is not enrolled yet: rossec node join again, or remove")
            say(f"        {printable(str(NodeHome.of(environment.home, name).path))}")
    failed = {(finding.node, finding.check) for finding in findings if not finding.ok}
    if failed:
        said = {(finding.text, finding.hint) for finding in findings if not finding.ok}
        of = f"{len(failed)} of {len(homes) * len(_checks(offline=offline))} checks"
        causes = (
            f"{of} failed" if len(said) >= len(failed) else f"{of} failed, {_causes(len(said))}"
        )
        raise ConfigurationError(causes, "see above")


@dataclass(frozen=True)
class Finding:
    """One line of a check, or the refusal that ended it."""

    node: str
    check: str
    ok: bool
    text: str
    hint: str = ""


def _all(environment: Environment) -> tuple[list[NodeHome], list[str]]:
    """The nodes of this machine, and the names of those that have a key and no identity yet.

    Where none has an identity, that is what has to be said of each.
    """
    found = [NodeHome.of(environment.home, name) for name in nodes_in(environment.home)]
    if not found:
        raise ConfigurationError(
            f"there is no node in {environment.home / 'nodes'}", missing_nodes(environment.home)
        )
    enrolled = [home for home in found if (home.path / "node.pem").exists()]
    if not enrolled:
        return found, []
    return enrolled, [home.name for home in found if home not in enrolled]


def _causes(number: int) -> str:
    return "for one cause" if number == 1 else f"for {number} causes"


def _checks(*, offline: bool) -> dict[str, Check]:
    checks: dict[str, Check] = {
        "identity": _identity, "address": _address, "grants": _grants, "domains": _domains,
    }  # fmt: skip
    return checks if offline else {**checks, "master": _master}


def _examine(environment: Environment, home: NodeHome, *, offline: bool) -> Iterator[Finding]:
    for name, check in _checks(offline=offline).items():
        try:
            for found in check(environment, home):
                yield _finding(home, name, found)
        except IdentityRevoked as error:
            yield _finding(home, name, error)
            return  # nobody talks to it: whatever else would be said has this cause
        except HintedError as error:
            yield _finding(home, name, error)


def _finding(home: NodeHome, check: str, found: Outcome) -> Finding:
    if isinstance(found, str):
        return Finding(home.name, check, True, found)
    return Finding(home.name, check, False, str(found), found.hint)


def _say(findings: list[Finding], plain: list[str], *, several: bool) -> None:
    """Each cause once, with the nodes that have it."""
    causes: dict[tuple[bool, str, str], list[str]] = {}
    for finding in findings:
        causes.setdefault((finding.ok, finding.text, finding.hint), []).append(finding.node)
    for (ok, text, hint), nodes in causes.items():
        who = f"{', '.join(map(shown, dict.fromkeys(nodes)))}: " if several else ""
        say(f"{state('ok    ' if ok else 'not ok')}  {printable(who + text)}")
        if not ok:
            say(f"        {printable(hint)}")
    for entry in plain:
        say(f"PLAIN   {printable(entry)} is neither encrypted nor checked: allow_plain names it")


def _identity(environment: Environment, home: NodeHome) -> Iterator[Outcome]:
    identity = home.identity(now())
    known = known_revocations(environment.home, home)
    if revoked := [key for key in identity.keys if key in known]:
        which = "" if revoked[0] == identity.thumbprint else "intermediate's "
        raise IdentityRevoked(
            f"the {which}key of {identity.name} is revoked according to {known[revoked[0]]}",
            anew(home),
        )
    yield f"{identity.name} of {identity.domain} until {format_time(identity.not_after)}"
    yield from _clock(home, identity)
    life = identity.not_after - signed_at(identity.not_before, identity.not_after)
    if identity.not_after - now() < life * _SOON:
        raise ConfigurationError(
            f"the identity ends soon, in {format_duration(identity.not_after - now())}, and was not"
            " renewed",
            f"it is while {home.name} runs, if where the authority is `rossec ca serve` runs and is"
            f" unlocked (rossec ca status); or there: rossec ca renew {home.name}, then here:"
            " rossec node install FILE",
        )


def _clock(home: NodeHome, identity: Identity) -> Iterator[Outcome]:
    """What the authority has signed shows a clock that is behind, also without a master."""
    signed = signed_at(identity.not_before, identity.not_after)
    if (data := home.load_revocations()) is not None:
        with suppress(RevocationRefused):  # a list of another authority says nothing
            signed = max(signed, open_statement(data, home.anchor().public_key).issued)
    if now() < signed - SKEW:
        yield ConfigurationError(
            f"the clock of this host is {format_duration(signed - now())} or more behind:"
            f" the authority has signed what is here at {format_time(signed)}",
            "set the clock of this host, or synchronize it (NTP)",
        )


def _address(environment: Environment, _: NodeHome) -> Iterator[Outcome]:
    yield from check_own_address(environment.variables)


def _grants(environment: Environment, home: NodeHome) -> Iterator[Outcome]:
    held, (usable, refused) = home.grants(), _opened(environment, home)
    for grant in usable:
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
        own = in_shell("{node}/**" if home.identity(now()).wildcard else f"{home.name}/**")
        raise ConfigurationError(
            "no grants: it may do nothing",
            f"at the authority, for example its own topics: rossec grant sign {home.name} --publish"
            f" {own}; a program says what it lacks when it is refused",
        )
    for errors in refused.values():
        others = f" (and {len(errors) - 1} more)" if errors[1:] else ""
        yield ConfigurationError(f"{errors[0]}{others}", errors[0].hint)


def _opened(
    environment: Environment, home: NodeHome
) -> tuple[list[Grant], dict[type[HintedError], list[HintedError]]]:
    """The grants that hold as far as this host knows, and why others do not, by kind."""
    revoked, refused = (
        known_revocations(environment.home, home),
        defaultdict[type[HintedError], list[HintedError]](list),
    )
    usable = []
    for data in home.grants():
        try:
            grant = open_held(home, data, now())
            _check_grant(grant, revoked)
        except HintedError as error:
            refused[type(error)].append(error)
        else:
            usable.append(grant)
    return usable, refused


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
            raise GrantRevoked(
                f"grant {grant.short_id} is revoked according to {revoked[entry]}",
                f"ask for another; it does no harm in {grant.subject}'s directory",
            )


def _domains(environment: Environment, home: NodeHome) -> Iterator[Outcome]:
    yield from check_domains(environment.home, home, now())


def _master(environment: Environment, home: NodeHome) -> Iterator[Outcome]:
    if home.name == own_master(environment.variables):  # it would meet its own certificate
        yield "the master of this host: rossec master status"
        return
    yield from asyncio.run(_ask_master(environment, home))


async def _ask_master(environment: Environment, home: NodeHome) -> list[Outcome]:
    """All that is found, and what ended it."""
    found = list[Outcome]()
    try:
        usable, _ = _opened(environment, home)
        async for outcome in check_master(environment, home, usable):
            found.append(outcome)
    except HintedError as error:
        found.append(error)
    return found


def _plain(environment: Environment) -> tuple[str, ...]:
    path = file_of(environment.variables)
    missing = ConfigurationError(f"{path} cannot be read")
    text = None
    if path.exists():  # as `rossec.secure` reads it
        text = files.read(path, _MAX_FILE, missing).decode(errors="replace")
    return read(environment.variables, text).allow_plain
