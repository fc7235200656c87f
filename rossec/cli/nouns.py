"""The groups of verbs that run no server, each with the places of its verbs."""

from pathlib import Path
from typing import Final

import click

from rossec.cli.shared import options
from rossec.cli.shared.context import Environment, LazyGroup

_CA: Final = {
    "approve": ("ca.enroll:approve", "request"),
    "backup": "ca.home:backup",
    "deny": ("ca.enroll:deny", "request"),
    "enroll": ("ca.enroll:enroll", "free"),
    "import": "ca.sign:import_",
    "init": ("ca.home:init", "free"),
    "intermediate": "nouns:intermediate",
    "invitations": "nouns:invitations",
    "invite": ("ca.invitations:command", "free"),
    "list": "ca.identities:list_",
    "lock": "ca.home:lock",
    "log": "nouns:log",
    "publish": "ca.identities:publish",
    "refresh": "ca.identities:refresh",
    "renew": ("ca.identities:renew", "recorded node"),
    "requests": "ca.enroll:requests",
    "restore": "ca.home:restore",
    "revoke": ("ca.identities:revoke", "recorded node or thing"),
    "serve": "ca.serve:serve",
    "show": ("ca.identities:show", "recorded node"),
    "sign": "ca.sign:sign",
    "status": "ca.home:status",
    "thing": ("ca.sign:thing", "thing"),
    "things": "ca.sign:things",
    "unlock": "ca.home:unlock",
}
_INTERMEDIATE: Final = {
    "install": "ca.sign:install_intermediate",
    "request": ("ca.sign:request_intermediate", "free"),
    "sign": "ca.sign:sign_intermediate",
}
_INVITATIONS: Final = {"revoke": ("ca.invitations:revoke", "invitation")}
_LOG: Final = {"head": "ca.identities:head", "prove": "ca.identities:prove", "verify": "ca.identities:verify"}
_NODE: Final = {
    "code": ("node.identity:code", "own node"),
    "confirm": ("node.enroll:confirm", "own node", "free"),
    "enroll": ("node.enroll:enroll", "own node"),
    "info": ("ros.graph:node_info", "running node"),
    "install": "node.identity:install",
    "join": "node.enroll:join_domain",
    "labels": ("node.enroll:labels", "own node"),
    "list": "ros.graph:list_nodes",
    "request": ("node.identity:request", "free"),
    "show": ("node.identity:show", "own node"),
}
_GRANT: Final = {
    "approve": ("grant.request:approve", "grant request"),
    "decide": "grant.request:decide",
    "deliver": "grant.delivery:deliver",
    "deny": ("grant.request:deny", "grant request"),
    "install": "grant.delivery:install",
    "list": ("grant.delivery:list_", "node"),
    "narrow": "grant.sign:narrow",
    "pending": "grant.request:pending",
    "presets": "grant.sign:presets",
    "request": ("grant.request:request", "own node"),
    "revoke": ("grant.delivery:revoke", "grant"),
    "show": "grant.delivery:show",
    "sign": ("grant.sign:sign", "node"),
}
_POLICY: Final = {
    "apply": "policy.apply:apply",
    "check": "policy.check:check",
    "import-sros2": "policy.check:import_",
    "learn": "policy.apply:learn",
    "lint": "policy.check:lint",
    "init": "policy.check:init",
    "review": "policy.apply:review",
    "test": "policy.check:test",
}
_PRIVACY: Final = {"opt-out": ("policy.apply:opt_out", "node")}
_DOMAIN: Final = {
    "accept": "domain:accept",
    "bundle": "domain:bundle",
    "limit": ("domain:limit", "domain"),
    "list": "domain:list_",
    "remove": ("domain:remove", "domain"),
    "show": ("domain:show", "domain"),
}
_FEDERATION: Final = {
    "add": ("sites:add_site", "free"),
    "list": "sites:list_sites",
    "param": ("sites:param", "domain", "free"),
    "remove": ("sites:remove_site", "domain"),
    "status": "status:federation_status",
}
_PARAM: Final = {
    "delete": ("ros.calls:delete_param", "free"),
    "get": ("ros.calls:get_param", "free"),
    "list": ("ros.calls:list_params", "free"),
    "set": ("ros.calls:set_param", "free", "free"),
}
_SERVICE: Final = {
    "call": ("ros.calls:call", "service", "free"),
    "info": ("ros.calls:service_info", "service"),
    "list": "ros.calls:list_services",
    "type": ("ros.calls:type_of_service", "service"),
}
_TOPIC: Final = {
    "bw": ("ros.topic:bw", "topic"),
    "echo": ("ros.topic:echo", "topic", "message type"),
    "find": ("ros.graph:find_topics", "message type"),
    "hz": ("ros.topic:hz", "topic"),
    "info": ("ros.graph:topic_info", "topic"),
    "list": ("ros.graph:list_topics", "free"),
    "pub": ("ros.topic:pub", "topic", "message type", "free"),
    "type": ("ros.graph:type_of_topic", "topic"),
}
_NAMESPACE: Final = {
    "check": "namespace:check",
    "launch": "namespace:launch",
    "messages": "namespace:messages",
    "name": "namespace:show_name",
    "rules": "namespace:show_rules",
    "serve": "namespace:serve",
}


@click.group(cls=LazyGroup, table=_CA)
def ca() -> None:
    """Run the authority, which signs the identities."""


@click.group(cls=LazyGroup, table=_INTERMEDIATE)
def intermediate() -> None:
    """Let a host sign nodes for a limited time, while the root stays offline."""


@click.group(cls=LazyGroup, table=_LOG, invoke_without_command=True)
@options.option("--last", "only the newest so many entries", type=click.IntRange(1))
@options.flag("--json in_json", "one line of JSON")
@click.pass_context
def log(context: click.Context, last: int | None, in_json: bool) -> None:
    """Show everything the authority did, oldest first."""
    if context.invoked_subcommand is not None:
        return
    from rossec.cli.ca.identities import show_log  # noqa: PLC0415 - imported when it runs

    show_log(context.ensure_object(Environment), last, in_json=in_json)


@click.group(cls=LazyGroup, table=_INVITATIONS, invoke_without_command=True)
@options.flag("--all everything", "also those that have ended")
@options.flag("--json in_json", "one line of JSON")
@click.pass_context
def invitations(context: click.Context, everything: bool, in_json: bool) -> None:
    """Show the invitations that can be used, and who joined by them."""
    if context.invoked_subcommand is not None:
        return
    from rossec.cli.ca.invitations import show  # noqa: PLC0415 - imported when it runs

    show(context.ensure_object(Environment), everything=everything, in_json=in_json)


@click.group(cls=LazyGroup, table=_NODE)
def node() -> None:
    """Prepare a node on its own machine."""


@click.group(cls=LazyGroup, table=_GRANT)
def grant() -> None:
    """Sign, show and revoke grants."""


@click.group(cls=LazyGroup, table=_POLICY)
def policy() -> None:
    """Write what is allowed, and check it."""


@click.group(cls=LazyGroup, table=_PRIVACY, invoke_without_command=True)
@options.option("--node", "only what this node sees")
@options.option("--field", "only fields with this in their path")
@options.flag("--held", "what is granted now, instead of what the policy allows")
@options.option("--html", "write a page to this file", type=options.PATH)
@options.as_json
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
    from rossec.cli.policy.explain import show_privacy  # noqa: PLC0415 - imported when it runs

    read = (context.ensure_object(Environment), policy_path)
    show_privacy(*read, node=node, field=field, held=held, html=html, as_json=as_json)


@click.group(cls=LazyGroup, table=_DOMAIN)
def domain() -> None:
    """Trust other domains, as far as you say."""


@click.group(cls=LazyGroup, table=_FEDERATION)
def federation() -> None:
    """Follow other masters: of the own domain, and of domains that are trusted.

    For the master on this host; with several, that of ROSSEC_MASTER.
    """


@click.group(cls=LazyGroup, table=_PARAM)
def param() -> None:
    """Read and write parameters."""


@click.group(cls=LazyGroup, table=_SERVICE)
def service() -> None:
    """List, ask and call services."""


@click.group(cls=LazyGroup, table=_TOPIC)
def topic() -> None:
    """Publish and listen."""


@click.group(cls=LazyGroup, table=_NAMESPACE)
def namespace() -> None:
    """Give names by rules: to a node, its topics and services, from its metadata.

    Names are proposals: nothing is renamed, and no right comes of one.
    """
