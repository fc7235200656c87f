"""The group `rossec border`, which runs the border router of constrained things."""

from typing import Final

import click
from click.core import ParameterSource

from rossec.cli.shared.context import Environment, pass_environment
from rossec.cli.shared.lazy import LazyGroup

_BORDER: Final = {
    "add": (
        "border.things:add",
        "Prepare the thing NAME: the request of its node, and its secret if it has one.",
    ),
    "credential": (
        "border.credential:credential",
        "Write the router's credential for its things to FILE: they know it by this key.",
    ),
    "forget": (
        "border.state:forget",
        "Forget the thing NAME: its statement and its secret are removed here.",
    ),
    "install": (
        "border.things:install",
        "Install what the authority signed about a thing: STATEMENT, and the identity in BUNDLE.",
    ),
    "labels": (
        "border.labels:labels",
        "Write a sheet of labels for the things with these CREDENTIALS, 24 to a page.",
    ),
    "list": ("border.state:list_", "List the things that this border router serves."),
    "status": (
        "border.state:status_",
        "Say what the border router that runs does: which things are there, what they offer.",
    ),
}
_PORT: Final = 5683


@click.group(cls=LazyGroup, table=_BORDER, invoke_without_command=True)
@click.option(
    "--as", "router", metavar="NAME", default="/border", show_default=True, help="its name"
)
@click.option("--listen", "host", metavar="ADDRESS", default="::", help="where; :: is everywhere")
@click.option("--port", default=_PORT, show_default=True, help="UDP port; 0 for any")
@click.option("--json", "as_json", is_flag=True, help="say where it listens as a line of JSON")
@click.option("--demo", "is_demo", is_flag=True, help="show it, with a lamp, in a home of its own")
@pass_environment
@click.pass_context
def border(
    context: click.Context, environment: Environment, router: str, host: str, port: int, *,
    as_json: bool, is_demo: bool,
) -> None:  # fmt: skip
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
        from rossec.cli.border.show_demo import show_demo  # noqa: PLC0415 - when it runs

        show_demo(context)
        return
    try:
        from rossec.cli.border.serve import run  # noqa: PLC0415 - an extra, and when it runs
    except ImportError as error:
        from rossec.cli.border.state import needs_extra  # noqa: PLC0415 - as above

        raise needs_extra() from error
    run(environment, router, host, port, as_json=as_json)
