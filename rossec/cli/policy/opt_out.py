"""`rossec privacy opt-out`: show a topic to no node, or no topic to a node."""

from pathlib import Path

import click

from ca.patterns import check_pattern
from grants import document
from rossec.authority.grant_delivery import require_delivered
from rossec.authority.policyfile import read_policy
from rossec.authority.service import AuthorityService
from rossec.cli.shared import options
from rossec.cli.shared.results import json_result
from rossec.cli.shared.service import deliver_grants, pass_service, publish_list
from rossec.terminal import record, say


@click.command("opt-out")
@click.argument("name")
@click.option("--node", "is_node", is_flag=True, help="NAME is a node, enrolled or not")
@options.master_uri
@options.policy
@json_result()
@pass_service
def opt_out(service: AuthorityService, name: str, is_node: bool, policy_path: Path | None) -> None:
    """Show the topic NAME to no node; or, when NAME is a node, show that node no topic.

    Adds a denial to the policy and revokes what was granted. Running connections end at once.
    What else the revoked grants allowed is granted anew.
    """
    check_pattern(name)
    policy = read_policy(service.rossec_home, policy_path)
    opted_out = service.opt_out(policy, name, is_node=is_node)
    record(rule=opted_out.rule, file=str(opted_out.policy.path))
    if opted_out.name != name:
        say(f"{name} is one of the anonymous nodes of {opted_out.name}, which are one identity:")
        say("all of them are opted out")
    say(f"rule {opted_out.rule} in {opted_out.policy.path} denies it from now on")
    withdrawn = service.revoke_opted_out(opted_out)
    for grant, _ in withdrawn:
        say(f"revoked grant {grant.id.hex()} of {grant.subject}")
    record(revoked_grants=[grant.id.hex() for grant, _ in withdrawn])
    reissued = [data for _, data in withdrawn if data is not None]
    for data in reissued:
        say(f"its other rights are grant {document.grant_id(data).hex()}")
    refused = deliver_grants(service, reissued)
    if withdrawn:
        publish_list(service)
    require_delivered(refused)
