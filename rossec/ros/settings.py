"""The settings of a ROS program from its command line and environment, as one pure function.

`name:=other` remaps, `_param:=value` sets a private parameter, `__name:=`, `__ns:=`, `__master:=`,
`__ip:=` and `__hostname:=` are ROS's own. Common mistakes are refused here with their
remedy, before they surface as "connection refused".
"""

import ipaddress
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Final
from urllib.parse import urlsplit

from ca.errors import NameRefused
from ca.names import check_name
from rossec.errors import ConfigurationError
from rossec.ros import names

DEFAULT_MASTER_URI: Final = "http://localhost:11311"
DEFAULT_PORT: Final = 11311
DOOR_PATH: Final = "/via"  # of a slave API's URI that a relay serves
_ASSIGN: Final = ":="
_SPECIAL: Final = frozenset({"__name", "__ns", "__master", "__ip", "__hostname", "__log"})


@dataclass(frozen=True)
class Settings:
    """One program's settings.

    Attributes:
        name: absolute name of the node.
        master_uri, master_host, master_port: where the master is.
        address: what the node registers (ROS_HOSTNAME, else ROS_IP), or None: find one.
        ipv6: prefer IPv6 (ROS_IPV6=on).
        remappings: resolved name -> resolved name.
        parameters: private parameters by their resolved name, values as written.
        arguments: what is left for the program itself.
    """

    name: str
    master_uri: str
    master_host: str
    master_port: int
    address: str | None
    ipv6: bool
    remappings: Mapping[str, str] = field(default_factory=dict)
    parameters: Mapping[str, str] = field(default_factory=dict)
    arguments: tuple[str, ...] = ()

    def resolve(self, name: str) -> str:
        """The absolute, remapped form of a name the program uses.

        Raises:
            NameRefused: it is not a ROS name.
        """
        return names.resolve_checked(name, self.name, self.remappings)


def read(argv: Sequence[str], environ: Mapping[str, str], *, default_name: str) -> Settings:
    """Settings from the arguments (without the program's path) and the environment.

    Raises:
        ConfigurationError: an invalid variable or argument; the hint has the remedy.
    """
    assignments, arguments = _split(argv)
    special = {key: value for key, value in assignments if key.startswith("__")}
    name = _node_name(special, environ, default_name)
    uri = special.get("__master", environ.get("ROS_MASTER_URI", DEFAULT_MASTER_URI))
    host, port = parse_uri(uri, "ROS_MASTER_URI")
    return Settings(
        name=name,
        master_uri=uri,
        master_host=host,
        master_port=port,
        address=_address(special, environ),
        ipv6=_ipv6(environ),
        remappings=_remappings(assignments, name),
        parameters=_parameters(assignments, name),
        arguments=arguments,
    )


def own_address(environ: Mapping[str, str]) -> str | None:
    """ROS_HOSTNAME or ROS_IP; None: neither is set.

    Raises:
        ConfigurationError: it is not the address of a host.
    """
    return _address({}, environ)


def parse_uri(uri: str, what: str = "uri", *, scheme: str = "http") -> tuple[str, int]:
    """Host and port of an `http://host:port` URI; of a service's, `scheme` is `rosrpc`.

    Raises:
        ConfigurationError: `what` holds something else.
    """
    hint = f"it looks like {scheme}://localhost:{DEFAULT_PORT}, with {scheme}:// and a port"
    try:
        parts = urlsplit(uri)
    except ValueError as error:  # a bracket that is not closed
        raise ConfigurationError(f"{what} is {uri!r}, which names no host", hint) from error
    if parts.scheme != scheme:
        raise ConfigurationError(f"{what} is {uri!r}, which does not begin with {scheme}://", hint)
    try:
        host, port = parts.hostname, parts.port
    except ValueError as error:
        raise ConfigurationError(f"{what} is {uri!r}, whose port is not a number", hint) from error
    if not host:
        raise ConfigurationError(f"{what} is {uri!r}, which names no host", hint)
    if not port:
        raise ConfigurationError(f"{what} is {uri!r}, which has no port", f"add :{DEFAULT_PORT}")
    return host, port


def build_uri(host: str, port: int, *, scheme: str = "http") -> str:
    """The URI that `parse_uri` takes apart; a numeric IPv6 host is put in brackets."""
    return f"{scheme}://[{host}]:{port}/" if ":" in host else f"{scheme}://{host}:{port}/"


def is_door(uri: str) -> bool:
    """Whether a slave API's URI is a relay's door: `http://host:port/via`.

    At a door the node's TCPROS connections are accepted too, so the address in its answer to
    `requestTopic` is not used: it is one of the node's own network.
    """
    try:
        return urlsplit(uri).path == DOOR_PATH
    except ValueError:
        return False


def build_door(host: str, port: int) -> str:
    """The URI of the door of a node, that `is_door` recognizes."""
    return build_uri(host, port).removesuffix("/") + DOOR_PATH


def is_loopback(host: str) -> bool:
    """Whether only this host can reach `host`, an address or name, without a resolver.

    A name is loopback only if it is `localhost`: 127.example.org may be any host.
    """
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return host.lower() == "localhost"


def _split(argv: Sequence[str]) -> tuple[list[tuple[str, str]], tuple[str, ...]]:
    assignments: list[tuple[str, str]] = []
    rest: list[str] = []
    for argument in argv:
        key, found, value = argument.partition(_ASSIGN)
        if not found:
            rest.append(argument)
        else:
            assignments.append(_assignment(argument, key.strip(), value.strip()))
    return assignments, tuple(rest)


def _assignment(argument: str, key: str, value: str) -> tuple[str, str]:
    if not key or not value:
        raise ConfigurationError(
            f"the argument {argument!r} lacks a side of ':='", "write it without spaces: from:=to"
        )
    if key.startswith("__") and key not in _SPECIAL:
        raise ConfigurationError(
            f"the argument {argument!r} is not one of ROS's own",
            "ROS knows " + ", ".join(sorted(_SPECIAL)),
        )
    return key, value


def _node_name(special: Mapping[str, str], environ: Mapping[str, str], default: str) -> str:
    """The node's name. A `default` with a namespace, as in `--as /site/robot`, brings its own."""
    inherited, _, base = default.rpartition(names.SEPARATOR)
    base = special.get("__name", base)
    base = base.removeprefix(names.SEPARATOR)
    if not base or names.SEPARATOR in base:
        raise ConfigurationError(
            f"the node name {special.get('__name', default)!r} contains a namespace",
            "give the namespace with __ns:=/name",
        )
    space = special.get("__ns") or inherited or environ.get("ROS_NAMESPACE", names.SEPARATOR)
    joined = f"/{space}/{base}"
    return _checked(names.canonical(joined), "the node name")


def _address(special: Mapping[str, str], environ: Mapping[str, str]) -> str | None:
    """ROS's order: __hostname, __ip, ROS_HOSTNAME, ROS_IP."""
    for key, source in (("__hostname", special), ("__ip", special)):
        if key in source:
            return _check_address(key, source[key])
    for key in ("ROS_HOSTNAME", "ROS_IP"):
        if key in environ:
            return _check_address(key, environ[key])
    return None


def _check_address(key: str, value: str) -> str:
    if not value:
        raise ConfigurationError(f"{key} is set but empty", f"unset {key}, or give an address")
    if "://" in value or "/" in value:
        raise ConfigurationError(f"{key} is {value!r}, an URI", "give the bare address, no http://")
    if key.lower().endswith("ip") and not _is_ip(value):
        raise ConfigurationError(
            f"{key} is {value!r}, which is not an IP address", "for a host name use ROS_HOSTNAME"
        )
    if ":" in value and not _is_ip(value):
        raise ConfigurationError(f"{key} is {value!r}, with a port", "give the address alone")
    return value


def _is_ip(value: str) -> bool:
    try:
        ipaddress.ip_address(value)
    except ValueError:
        return False
    return True


def _ipv6(environ: Mapping[str, str]) -> bool:
    value = environ.get("ROS_IPV6", "off")
    if value not in ("on", "off", ""):
        raise ConfigurationError(f"ROS_IPV6 is {value!r}", "ROS knows only on and off")
    return value == "on"


def _remappings(assignments: Sequence[tuple[str, str]], node: str) -> dict[str, str]:
    return {
        _checked(names.resolve(key, node), "a remapped name"): _checked(
            names.resolve(value, node), "a remapped name"
        )
        for key, value in assignments
        if not key.startswith("_")
    }


def _parameters(assignments: Sequence[tuple[str, str]], node: str) -> dict[str, str]:
    return {
        _checked(names.resolve(names.PRIVATE + key[1:], node), "a parameter"): value
        for key, value in assignments
        if key.startswith("_") and not key.startswith("__")
    }


def _checked(name: str, what: str) -> str:
    try:
        return check_name(name)
    except NameRefused as error:
        raise ConfigurationError(f"{what} {name!a} is not a ROS name", error.hint) from error
