"""The groups `rossec policy` and `rossec privacy`."""

from pathlib import Path
from typing import Final

import click

from rossec.cli.shared import options
from rossec.cli.shared.context import Environment
from rossec.cli.shared.lazy import LazyGroup

_POLICY: Final = {
    "apply": (
        "policy.apply:apply",
        "Put the policy in force: sign what it allows outright, revoke what it does not allow.",
    ),
    "check": (
        "policy.check:check",
        "Check the policy in FILE: its form, its words, conditions and filters, and its tests.",
    ),
    "import-sros2": (
        "policy.import_sros2:import_",
        "Turn the SROS2 policy in XML into one of rossec.",
    ),
    "learn": (
        "policy.learn:learn",
        "Add rules for what runs and no rule decides: exact names, marked for review.",
    ),
    "lint": (
        "policy.check:lint",
        "Warn of what the policy in FILE allows unwisely, such as a hidden value that still leaks.",
    ),
    "init": (
        "policy.init:init",
        "Write the commented beginning of a policy to FILE, which must not exist.",
    ),
    "review": (
        "policy.learn:review",
        "Go through a denial log, and answer for each line no rule decides.",
    ),
    "test": (
        "policy.test:test",
        "Run the tests in the policy FILE: what must stay true of it.",
    ),
}

_PRIVACY: Final = {
    "opt-out": (
        "policy.opt_out:opt_out",
        "Show the topic NAME to no node; or, when NAME is a node, show that node no topic.",
    ),
}


@click.group(cls=LazyGroup, table=_POLICY)
def policy() -> None:
    """Write what is allowed, and check it."""


@click.group(cls=LazyGroup, table=_PRIVACY, invoke_without_command=True)
@click.option("--node", help="only what this node sees")
@click.option("--field", help="only fields with this in their path")
@click.option("--held", is_flag=True, help="what is granted now, instead of what the policy allows")
@click.option("--html", type=click.Path(path_type=Path), help="write a page to this file")
@click.option("--json", "as_json", is_flag=True, help="one line of JSON")
@options.policy
@click.pass_context
def privacy(
    context: click.Context,
    node: str | None,
    field: str | None,
    held: bool,
    html: Path | None,
    as_json: bool,
    policy_path: Path | None,
) -> None:
    """Show every field of every topic: which node sees it, how, why and until when."""
    if context.invoked_subcommand is not None:
        return
    from rossec.cli.policy.privacy_report import show  # noqa: PLC0415 - imported when it runs

    read = (context.ensure_object(Environment), policy_path)
    show(*read, node=node, field=field, held=held, html=html, as_json=as_json)
