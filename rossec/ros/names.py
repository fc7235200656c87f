"""ROS names as programs write them, and a program's settings from command line and environment. Pure.

Names are relative, private or global, resolved against a node's name. The syntax of a complete name is
`ca.names`'s; here is only the resolution, equal to `rosgraph.names` so that stock callers get the names they
expect. Common mistakes in settings are refused here with their remedy, before they surface as "connection
refused".
"""

import ipaddress
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Final
from urllib.parse import urlsplit

from ca import names
from ca.errors import NameRefused
from ca.names import check_name
from rossec.errors import ConfigurationError

SEPARATOR: Final = "/"
PRIVATE: Final = "~"
ANY_TYPE: Final = "*"
MASTER: Final = names.MASTER  # the name a domain's first master is certified for
AUTHORITY: Final = "/ca"  # the name the authority's own node is certified for
DEFAULT_MASTER_URI: Final = "http://localhost:11311"
DEFAULT_PORT: Final = 11311
FORWARDED_PORT_PATH: Final = "/via"  # of a slave API's URI that a relay serves
_ASSIGN: Final = ":="
_SPECIAL: Final = frozenset({"__name", "__ns", "__master", "__ip", "__hostname", "__log"})
PRESENT_GRANTS: Final = "rossec.presentGrants"  # to the master, and to the slave API of a node
REVOCATION_UPDATE: Final = "rossec.revocationUpdate"  # from the master to a node
DOMAINS: Final = "rossec.domains"  # to the master
UPDATE_DOMAINS: Final = "rossec.updateDomains"
FOREIGN_REVOCATIONS: Final = "rossec.foreignRevocations"
FOREIGN_PROOFS: Final = "rossec.foreignRevocationProofs"
RENEW_IDENTITY: Final = "rossec.renewIdentity"
WATCH_RENEWALS: Final = "rossec.watchRenewals"  # to the master, from the authority's service
SETTLE_RENEWALS: Final = "rossec.settleRenewals"
RELAY_FORWARDED_PORTS: Final = "rossec.relayForwardedPorts"  # to the master, from a relay
RELAY_TARGET: Final = "rossec.relayTarget"
PORTS: Final = "rossec.ports"  # from a relay to a node
DOMAINS_UPDATE: Final = "rossec.domainsUpdate"  # from the master to a node
FOREIGN_UPDATE: Final = "rossec.foreignRevocationUpdate"
# What the master pushes that others signed: taken also while revocations are stale.
SIGNED_UPDATES: Final = frozenset({REVOCATION_UPDATE, DOMAINS_UPDATE, FOREIGN_UPDATE})


def canonical(name: str) -> str:
    """`name` without doubled and trailing slashes; a leading one stays."""
    if not name or name == SEPARATOR:
        return name
    if name[-1] != SEPARATOR and "//" not in name:  # the usual case
        return name
    lead = SEPARATOR if name.startswith(SEPARATOR) else ""
    return lead + SEPARATOR.join(part for part in name.split(SEPARATOR) if part)


def namespace(name: str) -> str:
    head, _, _ = name.removesuffix(SEPARATOR).rpartition(SEPARATOR)
    return head + SEPARATOR


def join(prefix: str, name: str) -> str:
    if not prefix or name.startswith((PRIVATE, SEPARATOR)):
        return name
    return prefix.removesuffix(SEPARATOR) + SEPARATOR + name


def resolve(name: str, node: str, remappings: Mapping[str, str] | None = None) -> str:
    # The global form of `name` for the node `node`. The result's syntax is not checked. The empty name is the
    # node's namespace. `remappings` maps resolved names to resolved names.
    if not name:
        return namespace(node)
    name = canonical(name)
    if name.startswith(PRIVATE):
        resolved = canonical(node + SEPARATOR + name[1:])
    elif name.startswith(SEPARATOR):
        resolved = name
    else:
        resolved = namespace(node) + name
    return resolved if remappings is None else remappings.get(resolved, resolved)


def search_paths(space: str, key: str) -> Iterator[tuple[str, str]]:
    above = [part for part in space.split(SEPARATOR) if part]
    first, *_ = key.split(SEPARATOR)
    for length in range(len(above), -1, -1):
        prefix = SEPARATOR + SEPARATOR.join(above[:length])
        yield join(prefix, first), join(prefix, key)


@dataclass(frozen=True)
class Settings:
    """One program's settings."""

    name: str  # absolute name of the node
    master_uri: str  # master_uri, master_host, master_port: where the master is
    master_host: str
    master_port: int
    address: str | None  # what the node registers (ROS_HOSTNAME, else ROS_IP), or None: find one
    ipv6: bool  # prefer IPv6 (ROS_IPV6=on)
    remappings: Mapping[str, str] = field(default_factory=dict)  # resolved name -> resolved name
    # private parameters by their resolved name, values as written
    parameters: Mapping[str, str] = field(default_factory=dict)
    arguments: tuple[str, ...] = ()  # what is left for the program itself

    def resolve(self, name: str) -> str:
        """The absolute, remapped form of a name the program uses."""
        return check_name(resolve(name, self.name, self.remappings))


def read(argv: Sequence[str], environ: Mapping[str, str], *, default_name: str) -> Settings:
    # 1. Assignments (`__name:=` and the like are ROS's own), and what is left for the program.
    assignments: list[tuple[str, str]] = []
    arguments: list[str] = []
    for argument in argv:
        key, found, value = argument.partition(_ASSIGN)
        if not found:
            arguments.append(argument)
            continue
        key, value = key.strip(), value.strip()
        if not key or not value:
            raise ConfigurationError(
                f"the argument {argument!r} lacks a side of ':='", "write it without spaces: from:=to"
            )
        if key.startswith("__") and key not in _SPECIAL:
            known = ", ".join(sorted(_SPECIAL))
            raise ConfigurationError(
                f"the argument {argument!r} is not one of ROS's own", f"ROS knows {known}"
            )
        assignments.append((key, value))
    # 2. The node, its master and its address.
    special = {key: value for key, value in assignments if key.startswith("__")}
    name = _node_name(special, environ, default_name)
    uri = special.get("__master", environ.get("ROS_MASTER_URI", DEFAULT_MASTER_URI))
    host, port = parse_uri(uri, "ROS_MASTER_URI")
    address = _address(special, environ)
    ipv6 = environ.get("ROS_IPV6", "off")
    if ipv6 not in ("on", "off", ""):
        raise ConfigurationError(f"ROS_IPV6 is {ipv6!r}", "ROS knows only on and off")
    # 3. Private parameters, `_param:=value`; all else remaps.
    remappings = {
        _checked(resolve(key, name), "a remapped name"): _checked(resolve(value, name), "a remapped name")
        for key, value in assignments
        if not key.startswith("_")
    }
    parameters = {
        _checked(resolve(PRIVATE + key[1:], name), "a parameter"): value
        for key, value in assignments
        if key.startswith("_") and not key.startswith("__")
    }
    return Settings(name, uri, host, port, address, ipv6 == "on", remappings, parameters, tuple(arguments))


def own_address(environ: Mapping[str, str]) -> str | None:
    """ROS_HOSTNAME or ROS_IP; None: neither is set."""
    return _address({}, environ)


def parse_uri(uri: str, what: str = "uri", *, scheme: str = "http") -> tuple[str, int]:
    """Host and port of an `http://host:port` URI; of a service's, `scheme` is `rosrpc`."""
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


def is_forwarded_port(uri: str) -> bool:
    # Whether a slave API's URI is a relay's forwarded port: `http://host:port/via`. At a forwarded port the
    # node's TCPROS connections are accepted too, so the address in its answer to `requestTopic` is not used:
    # it is one of the node's own network.
    try:
        return urlsplit(uri).path == FORWARDED_PORT_PATH
    except ValueError:
        return False


def build_forwarded_port(host: str, port: int) -> str:
    """The URI of the forwarded port of a node, that `is_forwarded_port` recognizes."""
    return build_uri(host, port).removesuffix("/") + FORWARDED_PORT_PATH


def is_loopback(host: str) -> bool:
    # Whether only this host can reach `host`, an address or name, without a resolver. A name is loopback only
    # if it is `localhost`: 127.example.org may be any host.
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return host.lower() == "localhost"


def _node_name(special: Mapping[str, str], environ: Mapping[str, str], default: str) -> str:
    inherited, _, base = default.rpartition(SEPARATOR)
    base = special.get("__name", base)
    base = base.removeprefix(SEPARATOR)
    if not base or SEPARATOR in base:
        raise ConfigurationError(
            f"the node name {special.get('__name', default)!r} contains a namespace",
            "give the namespace with __ns:=/name",
        )
    space = special.get("__ns") or inherited or environ.get("ROS_NAMESPACE", SEPARATOR)
    joined = f"/{space}/{base}"
    return _checked(canonical(joined), "the node name")


def _address(special: Mapping[str, str], environ: Mapping[str, str]) -> str | None:
    # In ROS's order: a host name before an address, the command line before the environment.
    sources = (special, ("__hostname", "__ip")), (environ, ("ROS_HOSTNAME", "ROS_IP"))
    found = ((key, source[key]) for source, keys in sources for key in keys if key in source)
    key, value = next(found, ("", ""))
    if not key:
        return None
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


def _checked(name: str, what: str) -> str:
    try:
        return check_name(name)
    except NameRefused as error:
        raise ConfigurationError(f"{what} {name!a} is not a ROS name", error.hint) from error
