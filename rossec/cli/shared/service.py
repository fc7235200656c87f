"""The authority of a command, with the passphrase and the master of its options; what it delivers."""

import contextlib
import functools
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any, Final

from ca.errors import HintedError
from ca.revocation.trust_status import NO_LIST_YET
from grants import document
from rossec import files
from rossec.authority.grant_operations import LATER, RefusedDeposit, SignedGrant
from rossec.authority.service import AuthorityService
from rossec.authority.session import StatementCall
from rossec.cli.shared import passphrase
from rossec.cli.shared.context import Environment, now, pass_environment
from rossec.cli.shared.master import master_as, master_at
from rossec.cli.shared.options import add_entry
from rossec.errors import ConfigurationError, NotDelivered, PeerUnreachable
from rossec.ros import names
from rossec.terminal import note, printable, record, say

_NO_LIST: Final = (
    "the master has no revocation list of this authority, so it trusts no grant yet:"
    " rossec ca publish, then rossec grant deliver"
)
_NAMED: Final = 5  # rights of the line


def pass_service(command: Callable[..., Any]) -> Callable[..., Any]:
    """Add `--passphrase-file` to a command, and pass it the authority instead of that option.

    The value of `--master` (`options.master_uri`) is taken for the authority as well.
    """

    @pass_environment
    @functools.wraps(command)
    def run(environment: Environment, /, *, passphrase_file: Path | None, **values: Any) -> None:
        master_uri = values.pop("master_uri", None)
        # The key is dropped when the command ends, also by a refusal.
        with contextlib.closing(service_of(environment, passphrase_file, master_uri)) as service:
            command(service, **values)

    return passphrase.option(run)


def service_of(
    environment: Environment, passphrase_file: Path | None = None, master_uri: str | None = None
) -> AuthorityService:
    return AuthorityService(
        environment.home,
        functools.partial(passphrase.read, passphrase_file, environment.variables),
        functools.partial(call_master, environment, master_uri),
        now,
    )


def call_master(environment: Environment, master_uri: str | None, call: StatementCall) -> object:
    """Call the master at `master_uri`, by default ROS_MASTER_URI, as the authority's own node.

    Returns the value of its answer.
    """
    import asyncio  # noqa: PLC0415 - what reads the record alone has no loop, and no network

    from rossec.ros.xmlrpc import Fault  # noqa: PLC0415 - likewise

    if call.note:
        note(call.note)
    uri = master_at(environment, call.node, master_uri)
    names.parse_uri(uri, "the master's URI")

    async def ask() -> object:
        async with asyncio.timeout(call.within), master_as(environment, call.node, uri) as client:
            return await client.ask(call.method, call.node.name, *call.statement)

    try:
        return asyncio.run(ask())
    except (HintedError, OSError, TimeoutError, Fault) as error:
        # Exit code 3: signed here, and not where it counts. It says what to do when the master is back.
        reason = str(error) or "no answer in time"
        if isinstance(error, Fault):
            reason = f"it answers {printable(error.faultString)}: is it of an older version?"
        what = f"the master at {uri} did not take {call.what}: {reason}"
        start = f"{error.hint}; " if isinstance(error, PeerUnreachable) else ""
        raise NotDelivered(what, f"{start}{call.hint}") from error


def publish_if_revoked(service: AuthorityService) -> None:
    """Deliver the list if a replaced key was revoked, and that of domains if a master is new in it.

    Else print a note if one was signed anew.
    """
    if service.has_revoked:
        say("the replaced key is revoked", replaced_key_revoked=True)
        publish_list(service)
        return
    if not service.has_signed_domains:
        remind_to_publish(service)
        return
    try:
        service.publish_domains()
        say("the master has the new list of domains, with the keys of all masters")
    except (NotDelivered, ConfigurationError) as error:
        note(f"{error}; {error.hint}")


def publish_list(service: AuthorityService) -> None:
    record(published=False)
    service.publish()
    say("the master has the new list", published=True)


def remind_to_publish(service: AuthorityService) -> None:
    if service.has_signed_list or service.has_signed_domains:
        note("a list for the master was due and is signed anew; deliver it with: rossec ca publish")


def deliver_grant(service: AuthorityService, data: bytes, out: Path | None) -> Sequence[RefusedDeposit]:
    """Write a grant to the file `out`, which somebody carries; else as `deliver_grants`."""
    if out is None:
        return deliver_grants(service, [data])
    files.create(out, data, 0o644)
    say(f"written to {out}", file=str(out))
    if (path := service.grants.store(data)) is not None:
        add_entry("given", {"node": document.peek(data).subject, "path": str(path)})
        say(f"given to {document.peek(data).subject} in {path}")
    return ()


def deliver_grants(service: AuthorityService, grants: Iterable[bytes]) -> Sequence[RefusedDeposit]:
    """Store each grant in its node's directory if that is in this home, deposit the others.

    A master that is out of reach is no failure of what was signed: a note says what to do later.
    Returns what it refuses, each said: `grant_delivery.require_delivered` makes a failure of it.
    """
    elsewhere = []
    for data in grants:
        node, path = document.peek(data).subject, None
        with contextlib.suppress(HintedError, OSError):  # one node's disk; it is said below
            path = service.grants.store(data)
        if path is None:
            elsewhere.append(data)
        else:
            add_entry("given", {"node": node, "path": str(path)})
            say(f"given to {node} in {path}")
    if not elsewhere:
        return ()
    try:
        refused = service.grants.deposit(elsewhere)
    except (NotDelivered, ConfigurationError) as error:
        record(undelivered=str(error))
        note(f"{error}; {LATER}")
        return ()
    say_deposited(len(elsewhere) - sum(not each.is_here for each in refused), refused)
    return refused


def say_deposited(count: int, refused: Sequence[RefusedDeposit]) -> None:
    """Say how many grants the master has now, and why others are refused or not stored."""
    record(deposited=count)
    if count == 1:
        say("the master has the grant, and gives it to the node")
    elif count:
        say(f"the master has {count} grants, and gives them to the nodes")
    for each in refused:
        short, reason = each.grant_id.hex()[:8], each.reason
        add_entry("refused", {"id": each.grant_id.hex(), "node": each.node, "error": reason})
        note(each.say(f"the grant {short}"))
    if any(NO_LIST_YET in each.reason for each in refused):
        note(_NO_LIST)


def give_outright(service: AuthorityService, name: str) -> None:
    """Grant `name` what the policy in force gives it, if there is one, and say so in one line.

    What the policy leaves to a person waits for a request. The identity is signed by then, so a
    policy that cannot be used is a note.
    """
    try:
        signed = service.policy.grant_outright(name)
    except HintedError as error:
        record(no_grants=str(error))
        note(f"{name} has no grants yet: {error}")
        note("correct it (rossec policy check), then: rossec policy apply")
        return
    if signed:
        record(granted=[document.grant_id(data).hex() for _, data in signed])
        say(f"the policy gives {name}: {_rights(signed)}")
        for each in deliver_grants(service, [data for _, data in signed])[:1]:
            note(each.hint)


def _rights(signed: list[SignedGrant]) -> str:
    found = [
        f"{item} (restricted)" if item.restriction else str(item)
        for _, data in signed
        for item in document.peek(data).permissions
    ]
    unique = list(dict.fromkeys(found))
    more = f", and {len(unique) - _NAMED} more" if len(unique) > _NAMED else ""
    return ", ".join(unique[:_NAMED]) + more
