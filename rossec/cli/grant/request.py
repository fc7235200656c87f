"""`rossec grant request | decide | pending | approve | deny`: nodes request grants."""

import secrets
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import click

from grants import document
from grants.filters.compile import compile_filter
from grants.filters.presets import PRESETS, preset
from grants.model import Restriction, Right
from grants.policy.decision import Verdict, restriction_lines
from grants.policy.drafts import approximate, shorten
from grants.policy.model import Effect, Policy
from grants.request import GrantRequest, RequestedRight, sign_request
from rossec import files
from rossec.authority import requests
from rossec.authority.approvals import (
    ApprovalQueue,
    PendingApproval,
    VerdictChange,
    seconds_left_today,
)
from rossec.authority.home import AuthorityHome
from rossec.authority.policyfile import PolicyFile, layout_of
from rossec.authority.signing import SigningAuthority
from rossec.cli.shared import options, passphrase
from rossec.cli.shared.context import Environment, format_time, now, pass_environment
from rossec.cli.shared.grant_delivery import deliver_grant
from rossec.cli.shared.policy import read_policy
from rossec.errors import ConfigurationError
from rossec.home import NodeHome
from rossec.terminal import note, printable, say, say_json

_ASKABLE = ("publish", "subscribe", "call", "provide", "param-get", "param-set", "graph")


def _wish_options(command: Callable[..., Any]) -> Callable[..., Any]:
    for label in reversed(_ASKABLE):
        command = click.option(f"--{label}", multiple=True, metavar="NAME")(command)
    return command


@click.command()
@click.argument("node")
@_wish_options
@click.option("--why", required=True, help="the reason, for the person or policy that decides")
@click.option("--out", type=click.Path(path_type=Path), help="write the request to this new file")
@pass_environment
def request(
    environment: Environment, /, node: str, why: str, out: Path | None, **named: tuple[str, ...]
) -> None:
    """Ask for rights as NODE, on its machine.

    The request is signed with the node's key. Carry it to the authority as a file; when the
    authority is in the same ROSSEC_HOME, it is put into its inbox.
    """
    home = NodeHome.find(environment.home, node)
    requested = tuple(
        RequestedRight(Right[label.upper()], pattern)
        for label, patterns in named.items()
        for pattern in patterns
    )
    if not requested:
        raise ConfigurationError("a request for nothing", "add --subscribe NAME, --publish NAME")
    identity = home.identity(now())
    asked = GrantRequest(
        identity.domain, identity.name, now(), secrets.token_bytes(16), requested, why
    )
    data = sign_request(home.credentials().signer, asked)
    say(f"request {asked.id.hex()} of {asked.node}")
    authority = environment.home / "ca"
    if out is not None:
        files.create(out, data, 0o644)
        say(f"written to {out}; at the authority: rossec grant decide {out}")
    elif (authority / "ca.pem").exists():
        requests.put_in_inbox(authority, asked, data)
        say("put into the authority's inbox; there: rossec grant decide")
    else:
        raise ConfigurationError("the authority is elsewhere", "give --out FILE, and carry it")


@click.command()
@click.argument(
    "request_files", nargs=-1, type=click.Path(path_type=Path, exists=True, dir_okay=False)
)
@click.option(
    "--out-dir", type=click.Path(path_type=Path, file_okay=False), help="write grants here too"
)
@options.policy
@passphrase.option
@pass_environment
def decide(
    environment: Environment,
    request_files: tuple[Path, ...],
    out_dir: Path | None,
    policy_path: Path | None,
    passphrase_file: Path | None,
) -> None:
    """Let the policy decide the requests in REQUEST_FILES and in the inbox.

    What it allows is signed; what it leaves to you is shown by `rossec grant pending`.
    """
    file = read_policy(environment, policy_path, signs=True)
    with _queue(environment, file) as queue:
        for path in request_files:
            queue.add_request(requests.read_request(path))
        _collect(queue)
        pending_approvals = queue.pending()
        allowed = [item for item in pending_approvals if item.verdict.effect is Effect.ALLOW]
        if allowed:
            authority = AuthorityHome.at(environment.home).unlock(
                passphrase.read(passphrase_file, environment.variables)
            )
            for data in _signed(queue, authority, allowed, lambda verdict: verdict, "policy"):
                _deliver(environment, data, out_dir)
        waiting = len(pending_approvals) - len(allowed)
        denied = f", {queue.denied_automatically} denied" if queue.denied_automatically else ""
        say(f"{len(allowed)} allowed, {waiting} for you{denied}: see `rossec grant pending`")


@click.command()
@click.option("--json", "as_json", is_flag=True, help="one line of JSON")
@options.policy
@pass_environment
def pending(environment: Environment, as_json: bool, policy_path: Path | None) -> None:
    """Show what nodes ask for and the policy leaves to you. No answer in time denies it."""
    file = read_policy(environment, policy_path, signs=True)
    with _queue(environment, file) as queue:
        _collect(queue)
        prompts = [item for item in queue.pending() if item.verdict.effect is Effect.PROMPT]
        if as_json:
            say_json([_summary(item) for item in prompts])
            return
        for item in prompts:
            _show(item, file)
        if not prompts:
            say("no open requests")


@click.command()
@click.argument("request_id")
@click.option("--approximate", "coarse", metavar="FILTER", help="only through this filter")
@click.option("--today", "only_today", is_flag=True, help="only until midnight")
@click.option("--out-dir", type=click.Path(path_type=Path, file_okay=False))
@options.policy
@passphrase.option
@pass_environment
def approve(
    environment: Environment,
    request_id: str,
    coarse: str | None,
    only_today: bool,
    out_dir: Path | None,
    policy_path: Path | None,
    passphrase_file: Path | None,
) -> None:
    """Approve the request REQUEST_ID (or its beginning), as it is or restricted.

    --approximate adds a filter of the policy or a preset, --today ends it at midnight.
    """
    file = read_policy(environment, policy_path, signs=True)
    change = _change(file, coarse, only_today)
    with _queue(environment, file) as queue:
        chosen = _chosen(queue, request_id)
        authority = AuthorityHome.at(environment.home).unlock(
            passphrase.read(passphrase_file, environment.variables)
        )
        for data in _signed(queue, authority, chosen, change, "a person"):
            _deliver(environment, data, out_dir)


@click.command()
@click.argument("request_id")
@options.policy
@pass_environment
def deny(environment: Environment, request_id: str, policy_path: Path | None) -> None:
    """Deny the request REQUEST_ID (or the beginning of it)."""
    with _queue(environment, read_policy(environment, policy_path, signs=True)) as queue:
        for item in _chosen(queue, request_id):
            queue.deny(item, "a person")
            say(f"denied {item.stored.request.node} {item.stored.requested}")


@contextmanager
def _queue(environment: Environment, file: PolicyFile) -> Iterator[ApprovalQueue]:
    queue = ApprovalQueue(AuthorityHome.at(environment.home), file, now())
    try:
        yield queue
    finally:
        queue.close()


def _collect(queue: ApprovalQueue) -> None:
    for error in queue.read_inbox():
        note(printable(f"a request was dropped: {error}"))


def _chosen(queue: ApprovalQueue, beginning: str) -> list[PendingApproval]:
    _collect(queue)
    found = [
        item
        for item in queue.pending()
        if item.verdict.effect is Effect.PROMPT
        and item.stored.request.id.hex().startswith(beginning.lower())
    ]
    if len({item.stored.request.id for item in found}) != 1 or not beginning:
        count = "several requests begin" if found else "no open request begins"
        hint = "see: rossec grant pending; without an answer in time it was denied"
        raise ConfigurationError(f"{count} with {beginning!r}", hint)
    return found


def _change(file: PolicyFile, coarse: str | None, only_today: bool) -> VerdictChange:
    if coarse is not None and coarse not in {*file.policy.filters, *PRESETS}:
        known = ", ".join({**file.policy.filters, **PRESETS})
        raise ConfigurationError(f"no filter {coarse!r} in {file.path}", f"there are: {known}")
    left = seconds_left_today(now()) if only_today else None

    def change(verdict: Verdict) -> Verdict:
        if coarse is not None:
            verdict = approximate(verdict, _restriction(file.policy, verdict.name, coarse))
        return verdict if left is None else shorten(verdict, left)

    return change


def _restriction(policy: Policy, topic: str, name: str) -> Restriction:
    """The filter `name` of the policy, or the preset of that name, for a topic."""
    kind = policy.type_of(topic)
    if kind is None:
        raise ConfigurationError(f"the type of {topic} is not known here", "add it to types")
    layout = layout_of(kind)
    if name not in policy.filters:
        return preset(name).restriction(layout)
    compile_filter(layout, policy.filters[name])
    return Restriction(kind, (), tuple(sorted(policy.filters[name])))


def _signed(
    queue: ApprovalQueue,
    authority: SigningAuthority,
    chosen: Sequence[PendingApproval],
    change: VerdictChange,
    reason: str,
) -> Iterator[bytes]:
    for draft, data in queue.sign(authority, chosen, change, reason):
        say(f"grant {document.grant_id(data).hex()} for {draft.subject} until "
            f"{format_time(draft.expires)}")  # fmt: skip
        for permission in draft.permissions:
            say(f"  may {permission.rights.label} {permission.pattern}")
            for line in permission.restriction.lines() if permission.restriction else ():
                say(f"    {line}")
        yield data


def _deliver(environment: Environment, data: bytes, out_dir: Path | None) -> None:
    out = None
    if out_dir is not None:
        out_dir.mkdir(parents=True, exist_ok=True)
        out = out_dir / f"{document.grant_id(data).hex()}.grant"
    deliver_grant(environment, document.peek(data).subject, data, out)


def _show(item: PendingApproval, file: PolicyFile) -> None:
    stored = item.stored
    say(f"{stored.short_id}  {stored.request.node} wants to {stored.requested}")
    say(f'  it says: "{printable(stored.request.why)}"')
    for rule in item.verdict.rules:
        say(f"  {rule.reason}")
    for line in restriction_lines(item.verdict):
        say(f"  {line}")
    until = stored.at + file.policy.defaults.prompt_timeout
    say(f"  denied, unless you answer by {format_time(until)}")
    say(f"  rossec grant approve {stored.short_id} [--approximate FILTER] [--today], or deny")


def _summary(item: PendingApproval) -> dict[str, object]:
    stored = item.stored
    return {
        "request": stored.request.id.hex(),
        "node": stored.request.node,
        "right": stored.requested.right.label,
        "name": stored.requested.pattern,
        "why": stored.request.why,
        "asked": stored.at,
        "restrictions": restriction_lines(item.verdict),
    }
