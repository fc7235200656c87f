"""`rossec border`: constrained things as nodes of ROS."""

from typing import Final

import click
from click.core import ParameterSource

from rossec.cli.shared.context import Environment, LazyGroup, pass_environment
from rossec.cli.shared.options import flag, option

_BORDER: Final = {
    "add": ("border.constrained_nodes:add", "free"),
    "credential": "border.constrained_nodes:credential",
    "forget": ("border.constrained_nodes:forget", "thing"),
    "install": "border.constrained_nodes:install",
    "labels": "border.constrained_nodes:labels",
    "list": "border.constrained_nodes:list_",
    "status": "border.constrained_nodes:status_",
}


@click.group(cls=LazyGroup, table=_BORDER, invoke_without_command=True)
@option("--as=NAME router", "its name", default="/border", show_default=True)
@option("--listen=ADDRESS host", "where; :: is everywhere", default="::")
@option("--port", "UDP port; 0 for any", default=5683, show_default=True)
@flag("--json as_json", "say where it listens as a line of JSON")
@flag("--demo is_demo", "show it, with a lamp, in a home of its own")
@pass_environment
@click.pass_context
def border(
    context: click.Context,
    environment: Environment,
    router: str,
    host: str,
    port: int,
    *,
    as_json: bool,
    is_demo: bool,
) -> None:
    """Run the border router of constrained things, as the node /border. Ends with Ctrl-C.

    Things reach it by CoAP (UDP). It serves those whose statement was installed by `install`; one
    that is installed while it runs is served at once.
    """
    if context.invoked_subcommand is not None:
        given = context.get_parameter_source
        if any(given(name) != ParameterSource.DEFAULT for name in context.params):
            raise click.UsageError("options of the router do not stand before a verb")
        return
    if is_demo:
        from rossec.cli.demo import show_border_demo  # noqa: PLC0415 - when it runs

        show_border_demo(context)
        return
    try:
        from rossec.cli.border.serve import run  # noqa: PLC0415 - an extra, and when it runs
    except ImportError as error:
        from rossec.cli.border.constrained_nodes import needs_extra  # noqa: PLC0415 - as above

        raise needs_extra() from error
    run(environment, router, host, port, as_json=as_json)
