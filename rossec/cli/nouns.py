"""The groups `rossec ca`, and `intermediate`, `invitations` and `log` in it.

The group `rossec node`: what is done on the machine of a node.

The group `rossec grant`.

The groups `rossec policy` and `rossec privacy`.

The group `rossec domain`.

The group `rossec federation`.

The group `rossec namespace`, which gives names by rules.

The groups `rossec param`, `rossec service` and `rossec topic`.
"""

from pathlib import Path
from typing import Final

import click

from rossec.cli.shared import options
from rossec.cli.shared.context import Environment, LazyGroup

_CA: Final = {
    "approve": (
        "ca.enroll:approve",
        "Approve the request REQUEST_ID (or its beginning), and sign its identity.",
    ),
    "backup": (
        "ca.backup:backup",
        "Write the authority into the new file FILE, encrypted under its passphrase.",
    ),
    "deny": ("ca.enroll:deny", "Deny the request REQUEST_ID (or its beginning)."),
    "enroll": (
        "ca.enroll:enroll",
        "Enroll the node that shows CODE: scanned from a picture, or pasted (in single quotes).",
    ),
    "import": (
        "ca.sign:import_",
        "Record the identities in BUNDLES (node.pem), which an intermediate enrolled or renewed.",
    ),
    "init": ("ca.init:init", "Create the authority of the trust domain DOMAIN, for example home."),
    "intermediate": (
        "nouns:intermediate",
        "Let a host sign nodes for a limited time, while the root stays offline.",
    ),
    "invitations": ("nouns:invitations", "Show the invitations that can be used, and who joined by them."),
    "invite": (
        "ca.invite:command",
        "Let nodes whose names PATTERN covers join by a code, without a person for each of them.",
    ),
    "list": ("ca.identities:list_", "List the identities that are valid now."),
    "lock": ("ca.serve:lock", "Let the running service drop the key at once."),
    "log": ("nouns:log", "Show everything the authority did, oldest first."),
    "publish": ("ca.identities:publish", "Give the newest revocation list to the master."),
    "refresh": (
        "ca.identities:refresh",
        "Sign the revocation list anew, before it expires, and give it to the master.",
    ),
    "renew": (
        "ca.identities:renew",
        "Renew the identity of NAME for the key it has; /ca is the authority's own node.",
    ),
    "requests": ("ca.enroll:requests", "Show the requests for an identity that have no answer yet."),
    "restore": ("ca.backup:restore", "Prove the backup FILE and put its authority back."),
    "revoke": (
        "ca.identities:revoke",
        "Revoke the identity of the node NAME, or with --thing the thing NAME, at once.",
    ),
    "serve": (
        "ca.serve:serve",
        "Hold the authority's key, so that commands need no passphrase. Ends with Ctrl-C.",
    ),
    "show": ("ca.identities:show", "Show the authority, or everything about the node NAME."),
    "sign": ("ca.sign:sign", "Sign the identity requests in REQUESTS, after showing them."),
    "status": ("ca.serve:status", "Show whether the authority's service runs, and whether it holds the key."),
    "thing": (
        "ca.sign:thing",
        "State that the thing NAME has this key or secret, and which border router serves it.",
    ),
    "things": ("ca.sign:things", "List the things that are stated now, with their border routers."),
    "unlock": (
        "ca.serve:unlock",
        "Give the running service the passphrase: it holds the key from now on, for a time.",
    ),
}

_INTERMEDIATE: Final = {
    "install": ("ca.sign:install_intermediate", "On the host: install BUNDLE, which the root signed."),
    "request": (
        "ca.sign:request_intermediate",
        "On the host: make its key and a request, to carry to the root of DOMAIN.",
    ),
    "sign": ("ca.sign:sign_intermediate", "At the root: sign REQUEST of a host, and set what it may do."),
}

_INVITATIONS: Final = {
    "revoke": (
        "ca.identities:revoke_invitations",
        "End the invitation INVITATION_ID (or its beginning); who joined by it stays enrolled.",
    )
}

_LOG: Final = {
    "head": ("ca.identities:head", "Sign the state of the log, to be kept elsewhere."),
    "prove": ("ca.identities:prove", "Print a proof, as JSON, against the newest signed head (RFC 6962)."),
    "verify": (
        "ca.identities:verify",
        "Recompute the whole log and compare it with the record and with every signed head.",
    ),
}


@click.group(cls=LazyGroup, table=_CA)
def ca() -> None:
    """Run the authority, which signs the identities."""


@click.group(cls=LazyGroup, table=_INTERMEDIATE)
def intermediate() -> None:
    """Let a host sign nodes for a limited time, while the root stays offline."""


@click.group(cls=LazyGroup, table=_LOG, invoke_without_command=True)
@click.option("--last", type=click.IntRange(1), help="only the newest so many entries")
@click.option("--json", "in_json", is_flag=True, help="one line of JSON")
@click.pass_context
def log(context: click.Context, last: int | None, in_json: bool) -> None:
    """Show everything the authority did, oldest first."""
    if context.invoked_subcommand is not None:
        return
    from rossec.cli.ca.identities import show_log as show  # noqa: PLC0415 - imported when it runs

    show(context.ensure_object(Environment), last, in_json=in_json)


@click.group(cls=LazyGroup, table=_INVITATIONS, invoke_without_command=True)
@click.option("--all", "everything", is_flag=True, help="also those that have ended")
@click.option("--json", "in_json", is_flag=True, help="one line of JSON")
@click.pass_context
def invitations(context: click.Context, everything: bool, in_json: bool) -> None:
    """Show the invitations that can be used, and who joined by them."""
    if context.invoked_subcommand is not None:
        return
    from rossec.cli.ca.identities import show_invitations as show  # noqa: PLC0415 - imported when it runs

    show(context.ensure_object(Environment), everything=everything, in_json=in_json)


_NODE: Final = {
    "code": ("node.identity:code", "Show the QR code of NAME's request, for the authority to scan."),
    "confirm": (
        "node.enroll:confirm",
        ("Confirm that the authority shows DIGITS for NAME, whose enrollment waits in another process."),
    ),
    "enroll": (
        "node.enroll:enroll",
        "Enroll the node NAME: show its code, wait for the authority, and for your confirmation.",
    ),
    "info": ("ros.graph:node_info", "Show what the running node NAME publishes, subscribes to and provides."),
    "install": (
        "node.identity:install",
        "Install the signed identity in BUNDLE, and trust the authority that signed it.",
    ),
    "join": (
        "node.enroll:join_domain",
        "Join a site by an invitation: make the key, prove the code, install the identity.",
    ),
    "labels": (
        "node.enroll:labels",
        "Write a sheet of labels for the nodes NAMES, 24 to a page; makes keys that are missing.",
    ),
    "list": ("ros.graph:list_nodes", "List the running nodes that NODE may see."),
    "request": ("node.identity:request", "Make the key of the node NAME and a request for its identity."),
    "show": ("node.identity:show", "Show the identity of NAME and how many grants it holds."),
}


@click.group(cls=LazyGroup, table=_NODE)
def node() -> None:
    """Prepare a node on its own machine."""


_GRANT: Final = {
    "approve": (
        "grant.request:approve",
        "Approve the request REQUEST_ID (or its beginning), as it is or restricted.",
    ),
    "decide": (
        "grant.request:decide",
        "Let the policy decide the requests in REQUEST_FILES and in the inbox.",
    ),
    "deliver": ("grant.delivery:deliver", "Deposit every grant in force that the master does not have."),
    "deny": ("grant.request:deny", "Deny the request REQUEST_ID (or the beginning of it)."),
    "install": (
        "grant.delivery:install",
        "Give the grant in FILE, or the chain, to its node, on the node's machine.",
    ),
    "list": (
        "grant.delivery:list_",
        "List the grants signed here, of one NODE or of all, and how far each has come.",
    ),
    "narrow": (
        "grant.sign:narrow",
        "Hand the grant in FILE on to another node of this domain, restricted further.",
    ),
    "pending": ("grant.request:pending", "Show what nodes ask for and the policy leaves to you."),
    "presets": ("grant.sign:presets", "Show what each preset hides, and what it still discloses."),
    "request": ("grant.request:request", "Ask for rights as NODE, on its machine."),
    "revoke": (
        "grant.delivery:revoke",
        "Revoke the grant GRANT_ID (or the beginning of it) and notify the master at once.",
    ),
    "show": ("grant.delivery:show", "Show what the grant in FILE allows; its signature is not checked."),
    "sign": (
        "grant.sign:sign",
        "Let NODE publish, subscribe, call and so on, under conditions and through filters.",
    ),
}


@click.group(cls=LazyGroup, table=_GRANT)
def grant() -> None:
    """Sign, show and revoke grants."""


_POLICY: Final = {
    "apply": (
        "policy.apply:apply",
        "Put the policy in force: sign what it allows outright, revoke what it does not allow.",
    ),
    "check": (
        "policy.check:check",
        "Check the policy in FILE: its form, its words, conditions and filters, and its tests.",
    ),
    "import-sros2": ("policy.check:import_", "Turn the SROS2 policy in XML into one of rossec."),
    "learn": (
        "policy.apply:learn",
        "Add rules for what runs and no rule decides: exact names, marked for review.",
    ),
    "lint": (
        "policy.check:lint",
        "Warn of what the policy in FILE allows unwisely, such as a hidden value that still leaks.",
    ),
    "init": ("policy.check:init", "Write the commented beginning of a policy to FILE, which must not exist."),
    "review": ("policy.apply:review", "Go through a denial log, and answer for each line no rule decides."),
    "test": ("policy.check:test", "Run the tests in the policy FILE: what must stay true of it."),
}

_PRIVACY: Final = {
    "opt-out": (
        "policy.apply:opt_out",
        "Show the topic NAME to no node; or, when NAME is a node, show that node no topic.",
    )
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
    from rossec.cli.policy.explain import show_privacy as show  # noqa: PLC0415 - imported when it runs

    read = (context.ensure_object(Environment), policy_path)
    show(*read, node=node, field=field, held=held, html=html, as_json=as_json)


_DOMAIN: Final = {
    "accept": ("domain.trust:accept", "Trust the domain of CARD, as far as these options say."),
    "card": ("domain.trust:card", "Write this domain's card, for the authority of another one."),
    "limit": ("domain.trust:limit", "Change how far, and until when, the domain LABEL is trusted."),
    "list": ("domain.listing:list_", "List the foreign domains that are trusted."),
    "remove": ("domain.trust:remove", "Trust the domain LABEL no more, and cut its connections."),
    "show": ("domain.listing:show", "Show how far the domain LABEL is trusted."),
}


@click.group(cls=LazyGroup, table=_DOMAIN)
def domain() -> None:
    """Trust other domains, as far as you say."""


_FEDERATION: Final = {
    "add": (
        "relay.sites:add_site",
        "Follow the master at URI, or behind the relay's peer PEER, and call it LABEL.",
    ),
    "list": ("relay.sites:list_sites", "List the masters to follow, as `rossec federation add` has them."),
    "param": ("relay.sites:param", "Mirror the parameters of LABEL that match PATTERN, read-only."),
    "remove": ("relay.sites:remove_site", "Follow LABEL no longer: its names go at once."),
    "status": (
        "status:federation_status",
        "Show how far each master is followed; the own one must have been started with --admin.",
    ),
}


@click.group(cls=LazyGroup, table=_FEDERATION)
def federation() -> None:
    """Follow other masters: of the own domain, and of domains that are trusted.

    For the master on this host; with several, that of ROSSEC_MASTER.
    """


_NAMESPACE: Final = {
    "check": (
        "namespace.serve:check",
        "Try RULES on the metadata of many nodes: which names are wrong, and why.",
    ),
    "launch": (
        "namespace.names:launch",
        "Write the launch file IN.launch again, with names that rules give in place of metadata.",
    ),
    "messages": (
        "namespace.messages:command",
        "Write the package rossec_namespace into DIRECTORY: the type of the service.",
    ),
    "name": ("namespace.names:show_name", "Show the name that rules give for the metadata in META."),
    "rules": ("namespace.show_rules:command", "Print the rules that are shipped, to be changed."),
    "serve": ("namespace.serve:serve", "Answer nodes that ask which name a topic or service of theirs gets."),
}


@click.group(cls=LazyGroup, table=_NAMESPACE)
def namespace() -> None:
    """Give names by rules: to a node, its topics and services, from its metadata.

    Names are proposals: nothing is renamed, and no right comes of one.
    """


_PARAM: Final = {
    "delete": ("ros.calls:delete_param", "Unset the parameter NAME and everything below it."),
    "get": ("ros.calls:get_param", "Print the parameter NAME, or a namespace with all in it."),
    "list": ("ros.calls:list_params", "List the parameters that NODE may read, of all or of one NAMESPACE."),
    "set": ("ros.calls:set_param", "Set the parameter NAME to VALUE (YAML, as in rosparam)."),
}

_SERVICE: Final = {
    "call": (
        "ros.calls:call",
        "Call the service NAME with CONTENT (YAML, as in rosservice) and print the answer.",
    ),
    "info": ("ros.calls:service_info", "Show which node provides the service NAME, where, and its type."),
    "list": ("ros.calls:list_services", "List the services that NODE may see."),
    "type": ("ros.calls:type_of_service", "Print the type of the service NAME."),
}

_TOPIC: Final = {
    "bw": ("ros.topic:bw", "Show how many bytes of the topic NAME arrive, as NODE may see them."),
    "echo": ("ros.topic:echo", "Print the messages of the topic NAME, as NODE may see them."),
    "find": ("ros.graph:find_topics", "List the topics whose messages are of TYPE."),
    "hz": ("ros.topic:hz", "Show how often messages of the topic NAME arrive, as NODE may see them."),
    "info": (
        "ros.graph:topic_info",
        "Show the type of the topic NAME and the nodes that publish and subscribe to it.",
    ),
    "list": ("ros.graph:list_topics", "List the topics that NODE may see, all or those below NAMESPACE."),
    "pub": ("ros.topic:pub", "Publish CONTENT (YAML, as in rostopic) on the topic NAME."),
    "type": ("ros.graph:type_of_topic", "Print the type of the topic NAME."),
}


@click.group(cls=LazyGroup, table=_PARAM)
def param() -> None:
    """Read and write parameters."""


@click.group(cls=LazyGroup, table=_SERVICE)
def service() -> None:
    """List, ask and call services."""


@click.group(cls=LazyGroup, table=_TOPIC)
def topic() -> None:
    """Publish and listen."""
