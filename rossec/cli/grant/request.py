"""`rossec grant request | decide | pending | approve | deny`: nodes request grants."""

import secrets
from collections.abc import Iterator, Sequence
from pathlib import Path

import click

from ca.names import shown
from grants import document
from grants.model import Right
from grants.policy.decision import restriction_lines
from grants.request import GrantRequest, RequestedRight, grant_command, in_shell, sign_request
from rossec import clock, files
from rossec.authority import requests
from rossec.authority.grant_operations import RefusedDeposit, SignedGrant, require_delivered
from rossec.authority.grant_queue import PendingGrantRequest, verdict_change
from rossec.authority.policyfile import PolicyFile, place, read_policy
from rossec.authority.service import AuthorityService
from rossec.cli.grant.sign import own_pattern, right_options
from rossec.cli.shared import options
from rossec.cli.shared.context import Environment, now, pass_environment
from rossec.cli.shared.options import FILE, FOLDER, PATH, Batch, flag, json_result, option, say_result
from rossec.cli.shared.service import deliver_grant, deliver_grants, pass_service, service_of
from rossec.errors import ConfigurationError
from rossec.home import NodeHome
from rossec.terminal import note, printable, record, say

_ASKABLE = ("publish", "subscribe", "call", "provide", "param-get", "param-set", "graph")


@click.command()
@click.argument("node")
@right_options({label: f"ask for the right {label} on NAME; may be repeated" for label in _ASKABLE}, "NAME")
@option("--why", "the reason, for the person or policy that decides", required=True)
@option("--out", "write the request to this new file", type=PATH)
@json_result(pass_environment)
def request(
    environment: Environment, /, node: str, why: str, out: Path | None, **named: tuple[str, ...]
) -> None:
    """Ask for rights as NODE, on its machine.

    The request is signed with the node's key. Carry it to the authority as a file; when the
    authority is in the same ROSSEC_HOME, it is put into its inbox.
    A NAME may be '{node}/pose': one of NODE's own.
    """
    home = NodeHome.find(environment.home, node)
    if not any(named.values()):
        raise ConfigurationError("a request for nothing", "add --subscribe NAME, --publish NAME")
    identity = home.identity(now())
    # Own names are resolved here: the authority gets a request for one node, and no words of a shell.
    requested = tuple(
        RequestedRight(Right[label.upper()], own_pattern(name, identity.name, tail=identity.wildcard))
        for label, names in named.items()
        for name in names
    )
    asked = GrantRequest(identity.domain, identity.name, now(), secrets.token_bytes(16), requested, why)
    data = sign_request(home.credentials().signer, asked)
    say(f"request {asked.id.hex()} of {asked.node}", request=asked.id.hex(), node=asked.node)
    authority = environment.home / "ca"
    if out is not None:
        files.create(out, data, 0o644)
        say(f"written to {out}; at the authority: rossec grant decide {out}", file=str(out))
    elif (authority / "ca.pem").exists():
        requests.put_in_inbox(authority, asked, data)
        say("put into the authority's inbox; there: rossec grant decide", inbox=True)
        if not place(environment.home, None).exists():
            sign = grant_command(asked.node, [(each.right, each.pattern) for each in requested])
            note(f"there is no policy that decides it: {sign}; or begin one: rossec policy init")
    else:
        raise ConfigurationError("the authority is elsewhere", "give --out FILE, and carry it")


@click.command()
@click.argument("request_files", nargs=-1, type=FILE)
@option("--out-dir", "write grants here too", type=FOLDER)
@options.policy
@options.master_uri
@json_result(pass_service)
def decide(
    service: AuthorityService, request_files: tuple[Path, ...], out_dir: Path | None, policy_path: Path | None
) -> None:
    """Let the policy decide the requests in REQUEST_FILES and in the inbox.

    What it allows is signed; what it leaves to you is shown by `rossec grant pending`.
    """
    policy = _collected(service, policy_path, request_files)
    decided = service.policy.decide(policy)
    refused = _deliver(service, decided.grants, out_dir)
    denied = len(decided.denied)
    record(allowed=decided.allowed, denied=denied, waiting=decided.waiting)
    for stored, reason in decided.denied:
        node, label, name = stored.request.node, stored.requested.right.label, stored.requested.pattern
        options.add_entry("denials", {"node": node, "right": label, "name": name, "reason": reason})
        say(f"denied {shown(node)} {label} {shown(name)}: {printable(reason)}")
        say(f"  what would change it: rossec explain {shown(node)} {label} {in_shell(shown(name))}")
    counts = [f"{decided.allowed} allowed", f"{decided.waiting} for you"]
    counts += [f"{denied} denied"] if denied else []
    see = ": see `rossec grant pending`" if decided.waiting else ""
    say(f"{', '.join(counts)}{see}")
    require_delivered(refused)


@click.command()
@options.as_json
@options.policy
@pass_environment
def pending(environment: Environment, as_json: bool, policy_path: Path | None) -> None:
    """Show what nodes ask for and the policy leaves to you. No answer in time denies it."""
    service = service_of(environment)
    policy = _collected(service, policy_path)
    prompts = service.policy.pending(policy)

    def lines() -> Iterator[str]:
        for item in prompts:
            stored = item.stored
            yield f"{stored.short_id}  {stored.request.node} wants to {stored.requested}"
            yield f'  it says: "{printable(stored.request.why)}"'
            yield from (f"  {rule.reason}" for rule in item.verdict.rules)
            yield from (f"  {line}" for line in restriction_lines(item.verdict))
            until = stored.at + policy.policy.defaults.prompt_timeout
            yield f"  denied, unless you answer by {clock.format_time(until)}"
            yield f"  rossec grant approve {stored.short_id} [--approximate FILTER] [--today], or deny"

    say_result(as_json, [_summary(item) for item in prompts], lines() if prompts else ["no open requests"])


@click.command()
@click.argument("request_ids", metavar="REQUEST_ID...", nargs=-1, required=True)
@option("--approximate=FILTER coarse", "only through this filter")
@flag("--today only_today", "only until midnight")
@option("--out-dir", "write the grant here too", type=FOLDER)
@options.policy
@options.master_uri
@json_result(pass_service)
def approve(
    service: AuthorityService,
    request_ids: tuple[str, ...],
    coarse: str | None,
    only_today: bool,
    out_dir: Path | None,
    policy_path: Path | None,
) -> None:
    """Approve the request REQUEST_ID (or its beginning), as it is or restricted.

    --approximate adds a filter of the policy or a preset, --today ends it at midnight. Where one of
    several is refused the others are approved, and the exit code is 1.
    """
    ids = options.unique(request_ids)
    policy = read_policy(service.rossec_home, policy_path, signs=True)
    # A filter that is unknown is refused before any request is approved with it.
    change = verdict_change(policy, coarse, now(), only_today=only_today)
    _collect(service, policy)
    if len(ids) > 1:
        service.unlock()  # a wrong passphrase is no fault of a request
    batch, signed = Batch(len(ids), "id"), list[SignedGrant]()
    for request_id in ids:
        with batch.item(request_id):
            signed += service.policy.approve(policy, request_id, change)
    refused = _deliver(service, signed, out_dir)
    batch.finish()
    require_delivered(refused)


@click.command()
@click.argument("request_ids", metavar="REQUEST_ID...", nargs=-1, required=True)
@options.policy
@json_result(pass_environment)
def deny(environment: Environment, request_ids: tuple[str, ...], policy_path: Path | None) -> None:
    """Deny the request REQUEST_ID (or the beginning of it).

    Where one of several is refused the others are denied, and the exit code is 1.
    """
    service, ids = service_of(environment), options.unique(request_ids)
    policy = _collected(service, policy_path)
    batch = Batch(len(ids), "id")
    for request_id in ids:
        with batch.item(request_id):
            for item in service.policy.deny(policy, request_id):
                options.add_entry("requests", {"node": item.stored.request.node, **_right(item)})
                say(f"denied {item.stored.request.node} {item.stored.requested}")
    batch.finish()


def _collected(
    service: AuthorityService, policy_path: Path | None, request_files: Sequence[Path] = ()
) -> PolicyFile:
    policy = read_policy(service.rossec_home, policy_path, signs=True)
    _collect(service, policy, request_files)
    return policy


def _collect(service: AuthorityService, policy: PolicyFile, request_files: Sequence[Path] = ()) -> None:
    for error in service.policy.collect_requests(policy, map(requests.read_request, request_files)):
        note(printable(f"a request was dropped: {error}"))


def _deliver(
    service: AuthorityService, signed: list[SignedGrant], out_dir: Path | None
) -> Sequence[RefusedDeposit]:
    for draft, data in signed:
        number = document.grant_id(data).hex()
        options.add_entry("grants", {"id": number, "node": draft.subject, "expires": draft.expires})
        say(f"grant {number} for {draft.subject} until {clock.format_time(draft.expires)}")
        for permission in draft.permissions:
            say(f"  may {permission}")
            for line in permission.lines():
                say(f"    {line}")
        if out_dir is not None:
            out_dir.mkdir(parents=True, exist_ok=True)
            deliver_grant(service, data, out_dir / f"{number}.grant")
    if out_dir is None:
        return deliver_grants(service, [data for _, data in signed])
    return ()


def _right(item: PendingGrantRequest) -> dict[str, object]:
    requested = item.stored.requested
    return {"right": requested.right.label, "name": requested.pattern}


def _summary(item: PendingGrantRequest) -> dict[str, object]:
    stored = item.stored
    return {
        "request": stored.request.id.hex(),
        "node": stored.request.node,
        **_right(item),
        "why": stored.request.why,
        "asked": stored.at,
        "restrictions": restriction_lines(item.verdict),
    }
