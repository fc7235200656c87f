"""`rossec border list | status | forget`: what a border router has of things, and does."""

from typing import Any

import click

from ca.things.credentials import ThingKey
from rossec.cli.border.things import as_border
from rossec.cli.shared.batch import Batch, unique
from rossec.cli.shared.context import Environment, now, pass_environment
from rossec.cli.shared.results import json_result
from rossec.clock import format_time
from rossec.errors import ConfigurationError
from rossec.home import NodeHome
from rossec.saved_things import ThingFiles
from rossec.terminal import fail, note, say, say_json

as_json_option = click.option("--json", "as_json", is_flag=True, help="a line of JSON")


@click.command("list")
@as_border
@as_json_option
@pass_environment
def list_(environment: Environment, router: str, *, as_json: bool) -> None:
    """List the things that this border router serves."""
    loaded = ThingFiles(_home(environment, router)).load()
    found = sorted(loaded.statements.values(), key=lambda each: each.name)
    if as_json:
        say_json(
            {
                "things": [
                    {"name": each.name, "kind": each.kind, "kid": each.credential.kid.hex(),
                     "expires": each.expires}
                    for each in found
                ]
            }
        )  # fmt: skip
        return
    for each in found:
        kind = "key" if isinstance(each.credential, ThingKey) else "secret"
        ends = "expired" if each.expires <= now() else f"until {format_time(each.expires)}"
        say(f"{each.name}  {kind} {each.credential.kid.hex()}  {ends}")
    for path, error in loaded.refused.items():
        fail(f"{path.name}: {error}", error.hint)
    if not found:
        note("there are no things here: rossec border add NAME --key FILE")


@click.command("status")
@as_border
@as_json_option
@pass_environment
def status_(environment: Environment, router: str, *, as_json: bool) -> None:
    """Say what the border router that runs does: which things are there, what they offer."""
    try:
        from rossec.border import status  # noqa: PLC0415 - an extra
    except ImportError:
        raise needs_extra() from None
    found = status.read(_home(environment, router).path, now())
    if as_json:
        say_json(found)
        return
    host, port = found["address"]
    counts = found["counts"]
    say(
        f"at {host} port {port}: {counts['handshakes'] + counts['derivations']} times a thing"
        f" came, {counts['refused']} of {counts['datagrams']} datagrams refused"
    )
    for name, thing in sorted(found["things"].items()):
        say(f"{name}  {_words(thing)}")


@click.command()
@click.argument("names", metavar="NAME...", nargs=-1, required=True)
@as_border
@json_result()
@pass_environment
def forget(environment: Environment, names: tuple[str, ...], router: str) -> None:
    """Forget the thing NAME: its statement and its secret are removed here.

    A border router that runs ends it within a second. The statement stays valid until the authority
    revokes it: rossec ca revoke --thing NAME
    """
    home, names = _home(environment, router), unique(names)
    batch = Batch(len(names), "name")
    for name in names:
        with batch.item(name):
            if not ThingFiles(home).forget(name):
                raise ConfigurationError(
                    f"there is nothing about {name} here", "see: rossec border list"
                )
            say(f"{name} is not served here any more")
            note(f"if it is lost, at the authority: rossec ca revoke --thing {name}")
    batch.finish()


def needs_extra() -> ConfigurationError:
    """The error that CoAP is not installed."""
    return ConfigurationError(
        "CoAP for things is not installed", "pip install 'rossec[constrained]'"
    )


def _home(environment: Environment, router: str) -> NodeHome:
    home = NodeHome.of(environment.home, router)
    home.anchor()
    return home


def _words(thing: dict[str, Any]) -> str:
    if "resources" not in thing:
        return "is there, starting" if thing["there"] else "not there"
    there = "there" if thing["there"] else "not there"
    return (
        f"{there}, offers {thing['offered']} of {thing['resources']},"
        f" {thing['received']} messages, {thing['refused'] + thing['over_rate']} dropped"
    )
