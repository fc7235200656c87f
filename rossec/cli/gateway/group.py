"""The group `rossec gateway`, which runs the gateway of a site."""

from typing import Any, Final

import click

from rossec.cli.shared.context import Environment, pass_environment
from rossec.cli.shared.lazy import LazyGroup

_GATEWAY: Final = {
    "status": ("gateway.status:status", "Show what the running gateway serves, and what not."),
}
_RULES: Final = "rossec.gateway.rules"
_EXAMPLE: Final = "rossec gateway --from hospital /robot/pose"


class GatewayGroup(LazyGroup):
    """Takes what stands behind `--from` out of the command line: click has no such options."""

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        """Keep the rules in the context, and parse the rest."""
        if any(word.partition("=")[0] == "--from" for word in args):
            from rossec.cli.gateway.words import split  # noqa: PLC0415 - not needed for help

            try:
                ctx.meta[_RULES], args = split(args)
            except click.UsageError as error:
                error.ctx = ctx  # whose help is hinted at
                raise
        return super().parse_args(ctx, args)


def _misplaced(_: click.Context, option: click.Parameter, value: Any) -> None:
    if value:
        raise click.UsageError(f"{option.opts[0]} stands behind --from and its patterns")


@click.group(cls=GatewayGroup, table=_GATEWAY, invoke_without_command=True)
@click.option(
    "--from", metavar="LABEL PATTERN...", expose_value=False, callback=_misplaced,
    help="serve these topics of the domain LABEL, by the names there; may be repeated",
)  # fmt: skip
@click.option(
    "--rate", metavar="N", expose_value=False, callback=_misplaced,
    help="at most N messages a second of each of them",
)  # fmt: skip
@click.option(
    "--newest", is_flag=True, expose_value=False, callback=_misplaced,
    help="of messages that wait for a slow line, send only the newest",
)  # fmt: skip
@click.option(
    "--compress", is_flag=True, expose_value=False, callback=_misplaced,
    help="send them compressed",
)  # fmt: skip
@click.option(
    "--name", metavar="NAME",
    help="which of the domain's gateways: /gateway, or /gateway/attic; instead of ROSSEC_GATEWAY",
)  # fmt: skip
@click.option("--json", "as_json", is_flag=True, help="say that it runs as a line of JSON")
@pass_environment
@click.pass_context
def gateway(
    context: click.Context, environment: Environment, name: str | None, *, as_json: bool
) -> None:
    """Run the gateway of this site, as the node /gateway. Ends with Ctrl-C.

    It brings topics of another domain here, once however many listen, and only while somebody
    does. What it gets of them its grant there says; who gets them here, the grants here on
    /gateway/LABEL/NAME. --rate, --newest and --compress are about the --from before them, which
    may be repeated: of several patterns that cover a topic the first one counts.
    """
    if name is not None:
        from rossec.environment import OWN_GATEWAY  # noqa: PLC0415 - not needed for help

        context.obj = environment = Environment({**environment.variables, OWN_GATEWAY: name})
    rules = context.meta.get(_RULES, ())
    if context.invoked_subcommand is not None:
        if rules or as_json:
            raise click.UsageError("only --name stands before a verb")
        return
    if not rules:
        raise click.UsageError(f"which topics shall it serve? {_EXAMPLE}")
    from rossec.cli.gateway.serve import run  # noqa: PLC0415 - imported when it runs

    run(environment, rules, as_json=as_json)
