"""`rossec console approvals`: what persons approved with their phones, and whether it is true."""

from contextlib import closing

import click

from ca.approvals.approval import Approval
from ca.approvals.statement import Kind
from ca.store.approvals import ApprovalEnd, ApprovalState
from rossec.authority.console.sentences import sentence
from rossec.authority.home import AuthorityHome
from rossec.cli.shared.context import Environment, pass_environment
from rossec.clock import format_time
from rossec.terminal import printable, say, say_json


@click.command()
@click.option("--verify", is_flag=True, help="recompute every signature, with the whole log")
@click.option("--json", "as_json", is_flag=True, help="one line of JSON")
@pass_environment
def approvals(environment: Environment, verify: bool, as_json: bool) -> None:
    """Show who approved what at the console, oldest first, and what came of it.

    With --verify: each was signed by a phone that was set up then, for exactly what was done; exit
    code 1 and the number of the first wrong entry of the log, if not.
    """
    home = AuthorityHome.at(environment.home)
    with closing(home.store()) as store:
        if verify:
            store.log.audit(home.own_key())
        phones = {passkey.id: passkey.name for passkey in store.passkeys.all()}
        found, ends = store.approvals.all(), store.approvals.ends()
    shown = [
        _summary(each, phones.get(each.passkey, "?"), ends.get(each.id), verified=verify)
        for each in found
    ]
    if as_json:
        say_json(shown)
        return
    for item in shown:
        say(printable(_line(item)))
    if verify:
        say(f"{len(found)} approval{'s' * (len(found) != 1)}, each signed by its phone")
    elif not found:
        say("nothing was approved at the console yet")


def _summary(
    approval: Approval, phone: str, end: ApprovalEnd | None, *, verified: bool
) -> dict[str, object]:
    statement = approval.read()
    return {
        "id": approval.id.hex(),
        "kind": Kind(approval.kind).name.lower().replace("_", "-"),
        "what": sentence(statement, approval.payload),
        "phone": phone,
        "at": approval.at,
        "state": str(ApprovalState.WAITING) if end is None else end.state,
        "result": "" if end is None else end.result,
        "statement": statement.challenge.hex(),
        **({"verified": True} if verified else {}),
    }


def _line(item: dict[str, object]) -> str:
    at = item["at"]
    time = format_time(at) if isinstance(at, int) else ""
    result = f" ({item['result']})" if item["result"] else ""
    head = f"{str(item['id'])[:8]}  {time}  {item['phone']}"
    return f"{head}  {item['what']}: {item['state']}{result}"
