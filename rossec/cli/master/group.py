"""The group `rossec master`, which runs the ROS master of a trust domain."""

from pathlib import Path
from typing import Any, Final

import click

from rossec.cli.shared import passphrase
from rossec.cli.shared.context import Environment, pass_environment
from rossec.cli.shared.lazy import LazyGroup

_MASTER: Final = {
    "delegate": (
        "master.delegate:delegate",
        "Let the master renew grants, unchanged and up to their caps, while the authority is away.",
    ),
    "status": (
        "master.admin:status",
        "Show the status of the running master; it must have been started with --admin.",
    ),
    "stop": (
        "master.admin:stop",
        "Stop the running master in order; it must have been started with --admin.",
    ),
}


@click.group(cls=LazyGroup, table=_MASTER, invoke_without_command=True)
@click.option(
    "--port",
    "-p",
    type=click.IntRange(0, 65535),
    help="instead of the one in ROS_MASTER_URI; 0 for any",
)
@click.option("--json", "as_json", is_flag=True, help="say the address as a line of JSON")
@click.option(
    "--complaints",
    type=click.Path(path_type=Path, dir_okay=False),
    help="denial log: append each missing right, for: rossec policy learn --from-log FILE",
)
@click.option(
    "--renew-identities",
    is_flag=True,
    help="with the intermediate of this host; without, the authority's service renews them",
)
@passphrase.option
@click.option(
    "--config",
    "config_file",
    type=click.Path(path_type=Path, dir_okay=False),
    help="a configuration file; the other options prevail over it",
)
@click.option("--log", type=click.Choice(["text", "json"]), help="form of the log on stderr")
@click.option("--admin", is_flag=True, help="open the local port of an administrator")
@click.option(
    "--name", "name", metavar="NAME",
    help="which of the domain's masters: /master, or /master/kitchen; instead of ROSSEC_MASTER",
)  # fmt: skip
@click.option(
    "--follow-announced", is_flag=True, help="follow every announced master of the own domain"
)
@click.option("--announce", is_flag=True, help="announce the master on the local links")
@click.option(
    "--metrics", type=click.IntRange(0, 65535), help="serve Prometheus on this port of loopback"
)
@click.option(
    "--post-quantum",
    metavar="POLICY",
    help="off, prefer or require; instead of ROSSEC_POST_QUANTUM",
)
@pass_environment
@click.pass_context
def master(
    context: click.Context,
    environment: Environment,
    port: int | None,
    as_json: bool,
    complaints: Path | None,
    config_file: Path | None,
    log: str | None,
    admin: bool,
    name: str | None,
    follow_announced: bool,
    announce: bool,
    metrics: int | None,
    renew_identities: bool,
    passphrase_file: Path | None,
    post_quantum: str | None,
) -> None:
    """Run a master, as the node /master. Ends with Ctrl-C."""
    if context.invoked_subcommand is not None:
        return
    from rossec.cli.master.serve import run  # noqa: PLC0415 - imported when it runs
    from rossec.environment import OWN_MASTER, own_master  # noqa: PLC0415 - as above

    given: dict[str, Any] = {"port": port, "log": log, "complaints": complaints, "metrics": metrics}
    given |= {"admin": admin or None, "announce": announce or None}  # a flag only switches on
    run(
        environment,
        config_file,
        {key: value for key, value in given.items() if value is not None},
        passphrase_file,
        renew_identities=renew_identities,
        post_quantum=post_quantum,
        name=own_master(environment.variables if name is None else {OWN_MASTER: name}),
        follow_announced=follow_announced,
        as_json=as_json,
    )
