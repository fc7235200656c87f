"""The authority's service as the console's commands ask it, and the code that they show."""

from urllib.parse import quote, urlsplit

from ca.enrollment import qr
from rossec.authority.home import AuthorityHome
from rossec.authority.keyservice.client import KeyServiceClient
from rossec.console.options import LOCALHOST
from rossec.errors import ConfigurationError
from rossec.terminal import say, say_picture


def running_service(home: AuthorityHome) -> KeyServiceClient:
    """The service of the authority in `home`.

    Raises:
        ConfigurationError: none runs.
        KeyServiceFailed: another user listens there, or it does not answer.
    """
    client = KeyServiceClient.find(home.path)
    if client is None:
        raise ConfigurationError(
            "the authority's service does not run", "start it in another terminal: rossec ca serve"
        )
    return client


def login_address(origin: str, code: str, name: str = "") -> str:
    """The address that logs in with a code; in the fragment, which browsers send to nobody."""
    return f"{origin}/login#{code}" + (f".{quote(name, safe='')}" if name else "")


def show_code(address: str) -> None:
    """Print an address with a code, and as a QR code."""
    say_picture(qr.terminal(address))
    say(address)
    if urlsplit(address).hostname == LOCALHOST:
        say("for a browser of this computer; for a phone see: rossec console --help, --lan")
    say("works once, within 2 minutes; another one: rossec console phone")
