"""URIs with IPv6 literals, which stock rospy writes without brackets and cannot read. Pure."""

from typing import Final

from rossec.errors import ConfigurationError

ROSRPC: Final = "rosrpc://"


def bracketed(uri: str) -> str:
    """`uri` with brackets around an IPv6 literal that lacks them; any other as it is."""
    scheme, mark, rest = uri.partition("://")
    authority, slash, path = rest.partition("/")
    host, colon, port = authority.rpartition(":")
    if ":" not in host or host.startswith("["):
        return uri
    return f"{scheme}{mark}[{host}]{colon}{port}{slash}{path}"


def parse_rosrpc(uri: str) -> tuple[str, int]:
    """Host and port of a service's URI.

    Raises:
        ConfigurationError: invalid.
    """
    authority = uri.removeprefix(ROSRPC).partition("/")[0]
    host, _, port = authority.rpartition(":")
    if not uri.startswith(ROSRPC) or not host or not port.isdecimal():
        raise ConfigurationError(
            f"{uri!r} is not the URI of a service", "it has the form rosrpc://host:port"
        )
    return host.removeprefix("[").removesuffix("]"), int(port)
