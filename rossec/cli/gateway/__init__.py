"""`rossec gateway`: one copy of another domain's topics, for all of this site."""

from typing import Any, Final

import click

from rossec.cli.shared.context import Environment, LazyGroup, pass_environment
from rossec.cli.shared.options import flag, option

_GATEWAY: Final = {"status": "status:gateway_status"}
_RULES: Final = "rossec.gateway.rules"


class GatewayGroup(LazyGroup):
    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
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
@option(
    "--from",
    "serve these topics of the domain LABEL, by the names there; may be repeated",
    metavar="LABEL PATTERN...",
    expose_value=False,
    callback=_misplaced,
)
@option("--rate=N", "at most N messages a second of each of them", expose_value=False, callback=_misplaced)
@flag(
    "--newest",
    "of messages that wait for a slow line, send only the newest",
    expose_value=False,
    callback=_misplaced,
)
@flag("--compress", "send them compressed", expose_value=False, callback=_misplaced)
@option(
    "--name=NAME", "which of the domain's gateways: /gateway, or /gateway/attic; instead of ROSSEC_GATEWAY"
)
@flag("--json as_json", "say that it runs as a line of JSON")
@pass_environment
@click.pass_context
def gateway(context: click.Context, environment: Environment, name: str | None, *, as_json: bool) -> None:
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
        raise click.UsageError("which topics shall it serve? rossec gateway --from hospital /robot/pose")
    from rossec.cli.gateway.serve import run  # noqa: PLC0415 - imported when it runs

    run(environment, rules, as_json=as_json)
