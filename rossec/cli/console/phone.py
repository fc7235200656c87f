"""`rossec console phone`: a one-time code for a phone."""

import time
from contextlib import closing
from typing import Final

import click

from rossec.authority.console.codes import LIFETIME
from rossec.authority.home import AuthorityHome
from rossec.cli.console.service import login_address, running_service, show_code
from rossec.cli.shared.context import Environment, pass_environment
from rossec.console.address import read_address
from rossec.console.phone_names import MAX_NAME
from rossec.errors import ConfigurationError
from rossec.terminal import printable, say, say_json

_PERIOD: Final = 0.5  # seconds between two looks at the record


@click.command()
@click.option("--name", default="", help="what the phone will be called; it can be changed there")
@click.option("--no-wait", is_flag=True, help="do not wait until the phone is set up")
@click.option("--json", "as_json", is_flag=True, help="one line of JSON; does not wait")
@pass_environment
def phone(environment: Environment, name: str, no_wait: bool, as_json: bool) -> None:
    """Show a one-time code that logs in a phone, and can set it up to approve.

    Scan it with the phone, or open the address. It works once, within 2 minutes, either to look or
    to set up the phone. Waits until a phone is set up; Ctrl-C ends the waiting, not the code.
    """
    if len(name) > MAX_NAME or (name and not name.isprintable()):
        raise ConfigurationError(
            f"a phone's name is one line of at most {MAX_NAME} characters", "shorten it"
        )
    home = AuthorityHome.at(environment.home)
    with closing(running_service(home)) as client:
        origin = read_address(home.path)
        known = _phones(home)
        address = login_address(origin, client.phone_code(), name)
    if as_json:
        say_json({"login": address, "seconds": int(LIFETIME)})
        return
    show_code(address)
    if not no_wait:
        say(_wait(home, known))


def _phones(home: AuthorityHome) -> dict[bytes, str]:
    """The phones that can approve: names by id."""
    with closing(home.store()) as store:
        return {passkey.id: passkey.name for passkey in store.passkeys.active()}


def _wait(home: AuthorityHome, known: dict[bytes, str]) -> str:
    """What came of the code, as far as the record tells: looking leaves no trace there."""
    end = time.monotonic() + LIFETIME
    while time.monotonic() < end:
        for number, name in _phones(home).items():
            if number not in known:
                return f"{printable(name)} is set up"
        time.sleep(_PERIOD)
    return "the code is over, and set up no phone"
