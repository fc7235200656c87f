"""`rossec relay`, `rossec router accounts | share | take`, `rossec federation`: other sites."""

import secrets
import sys
from collections.abc import Callable
from contextlib import suppress
from dataclasses import replace
from functools import partial
from operator import methodcaller
from pathlib import Path
from typing import Any, Final, TypeVar

import click

from ca.domains import Anchors
from ca.errors import CAError, DomainsRefused
from ca.names import MASTER, check_label, display_name
from rossec import files
from rossec.authority.local_list import LocalList
from rossec.cli.shared.context import Environment, pass_environment
from rossec.cli.shared.options import FILE, Batch, flag, json_result, option, say_result, unique
from rossec.environment import own_master, own_relay
from rossec.errors import ConfigurationError
from rossec.federation import SiteFile, SiteSettings, checked_sites
from rossec.home import NodeHome
from rossec.overlay.documents import MAX_ACCOUNT_FILE, MAX_DESCRIPTOR, Peer, RelayDescriptor, check_account
from rossec.overlay.homes import DIRECTORY, RelayFiles, RouterHome, new_password
from rossec.overlay.link_frames import BOX, inbox
from rossec.overlay.router_tls import MAX_SHARE_FILE, Share
from rossec.saved_statements import DomainFiles
from rossec.terminal import note, printable, record, say, say_json, say_secret

RELAY_SOCKET: Final = "admin.sock"
_LISTED = "at the authority: rossec domain accept BUNDLE; then the master has the list, and the relay"
_Known = TypeVar("_Known", Peer, SiteSettings)
pass_home = click.make_pass_decorator(RouterHome)


@click.command()
@click.argument("label")
@option(
    "--domain=DOMAIN-LABEL",
    "only a relay of this trusted domain may use it; '' for the own domain",
    default=None,
)
@pass_environment
def descriptor(environment: Environment, label: str, domain: str | None) -> None:
    """Print the descriptor for the relay LABEL: the inbox that it alone shall send to.

    The same again each time, and after a change of the account a new one. Hand it to that relay's
    operator only. Without --domain the descriptor that comes back says of which domain LABEL is.
    """
    store = relay_files(environment)
    own = store.home.anchor().domain
    routers = store.routers()
    if domain and known_domains(environment, store.home).listed(domain) is None:
        raise ConfigurationError(f"no trusted domain is called {domain[:40]!a}", _LISTED)

    def put(peers: dict[str, Peer]) -> None:
        peer = peers.setdefault(label, Peer(check_label(label), secrets.token_hex(BOX), domain))
        if domain is None or domain == peer.domain:
            return
        if peer.is_complete:
            raise ConfigurationError(f"{label} is {peer.shown} already", f"rossec relay remove {label}")
        peers[label] = replace(peer, domain=domain)

    store.change(put)
    # An inbox for each peer: one relay may send there, and no other (decision 0034).
    box = bytes.fromhex(store.peers()[label].box)
    say_secret(RelayDescriptor(own, store.home.name, inbox(routers.account, box)).write().rstrip())
    if not store.peers()[label].is_complete:
        note(f"for the relay {label} alone; there: rossec relay add LABEL FILE")
        note(f"here, its descriptor: rossec relay add {label} FILE")


def relay_files(environment: Environment) -> RelayFiles:
    """The files of this host's relay, which need not be enrolled."""
    return RelayFiles(NodeHome.of(environment.home, own_relay(environment.variables)))


def known_domains(environment: Environment, home: NodeHome) -> Anchors:
    """The newest list of domains on this host: of the relay, its master, or the authority."""
    anchors = Anchors(home.anchor())
    master = NodeHome.of(environment.home, own_master(environment.variables))
    found = [DomainFiles(each, anchors.own).load_domains() for each in (home, master)]
    for data in (*found, LocalList(environment.home).domains()):
        if data:
            with suppress(DomainsRefused):  # of another authority, or older than one of the others
                anchors.update(data)
    return anchors


@click.command()
@click.argument("label")
@click.argument("file", type=FILE)
@json_result(pass_environment)
def add_relay(environment: Environment, label: str, file: Path) -> None:
    """Take the descriptor in FILE of another site's relay, and call it LABEL.

    Links with it are made once it has this relay's descriptor too: rossec relay descriptor LABEL. A running
    relay takes it within a second.
    """
    store = relay_files(environment)
    found = RelayDescriptor.read(files.read(file, MAX_DESCRIPTOR))
    anchors, domain = known_domains(environment, store.home), ""
    if found.domain != anchors.own.domain:
        listed = anchors.listed_domain(found.domain)
        if listed is None:
            raise ConfigurationError(f"the descriptor is of domain {found.domain}, not trusted here", _LISTED)
        domain = listed.entry.label
    # Whoever brings it, that relay proves itself by certificate at each link (attack `relay-impostor`).
    if not domain and found.relay == store.home.name:
        raise ConfigurationError(
            f"this is the descriptor of {found.relay}, the relay of this host itself",
            "add the descriptor that the other relay printed",
        )

    def put(peers: dict[str, Peer]) -> None:
        peer = peers.get(label) or Peer(check_label(label), secrets.token_hex(BOX))
        if peer.domain is not None and peer.domain != domain:
            raise ConfigurationError(
                f"the descriptor is of domain {found.domain}, and {label} is to be of"
                f" {peer.domain or 'the own one'}",
                f"take the right descriptor, or begin anew: rossec relay remove {label}",
            )
        if peer.is_complete and peer.relay != found.relay:
            raise ConfigurationError(f"{label} is {peer.shown} already", f"rossec relay remove {label}")
        peers[label] = replace(peer, domain=domain, relay=found.relay, inbox=found.inbox)

    store.change(put)
    say(f"{label} is {store.peers()[label].shown}", label=label, domain=domain, relay=found.relay)
    note(f"it needs this relay's descriptor too: rossec relay descriptor {label} > FILE, and there: add")


@click.command()
@click.argument("labels", metavar="LABEL...", nargs=-1, required=True)
@json_result(pass_environment)
def remove_relay(environment: Environment, labels: tuple[str, ...]) -> None:
    """Link with LABEL no longer: its links end at once.

    Its inbox is gone: a descriptor that was handed out for it is of no use any more.
    """
    labels = unique(labels)
    batch = Batch(len(labels), "name")
    for label in labels:
        with batch.item(label):
            relay_files(environment).change(partial(_take_out, label, "peer"))
            say(f"{label} is linked with no longer")
    batch.finish()


def _take_out(label: str, what: str, known: dict[str, _Known]) -> None:
    _find(known, label, what)
    del known[label]


def _find(known: dict[str, _Known], label: str, what: str) -> _Known:
    if label not in known:
        there = ", ".join(sorted(known)) or "none"
        raise ConfigurationError(f"there is no {what} {label[:40]!a}", f"there are: {there}")
    return known[label]


@click.command("list")
@flag("--json as_json", "a line of JSON for each")
@pass_environment
def list_relays(environment: Environment, *, as_json: bool) -> None:
    """List the relays of other sites, as descriptors have named them."""
    peers = relay_files(environment).peers()
    for label, each in sorted(peers.items()):
        if as_json:
            say_json({"label": label, "domain": each.domain, "relay": each.relay})
        else:
            say(printable(f"{label:<16} {each.shown or 'its descriptor is not here yet'}"))
    if not peers and not as_json:
        note("no relay of another site: rossec relay descriptor LABEL, rossec relay add LABEL FILE")


@click.command()
@click.argument("file", type=FILE)
@json_result(pass_environment)
def account(environment: Environment, file: Path) -> None:
    """Keep the account FILE that the operator of the routers made.

    It has a password in it. A relay that runs uses it when it is started again.
    """
    store = relay_files(environment)
    before = store.routers().account if store.has_account else ""
    found = store.keep_account(files.read(file, MAX_ACCOUNT_FILE))
    record(account=found.account, locators=list(found.locators))
    say(printable(f"account {found.account} at {' '.join(found.locators)}"))
    # Inboxes are derived from the account: descriptors that were handed out name the old ones.
    if before and before != found.account:
        note("the inboxes have other keys now: hand out the descriptors again, rossec relay descriptor LABEL")
    note(f"{file} is not needed any more, and whoever has it has the account: remove it")


def _reached(command: Callable[..., Any]) -> Callable[..., Any]:
    # Options of what makes an account file: where the router is found, if it was not told yet.
    listen = option(
        "--listen=LOCATOR",
        "where this router will listen, if it never ran yet; as of rossec router",
        multiple=True,
    )
    host = option(
        "--host=NAME", "name or address by which relays reach this router; may be repeated", multiple=True
    )
    return host(listen(command))


@click.command()
@click.argument("name")
@_reached
@pass_home
def add_account(home: RouterHome, name: str, host: tuple[str, ...], listen: tuple[str, ...]) -> None:
    """Make the account NAME, and print its file for the relay of that site.

    For example: rossec router accounts add home > home.account. The file holds a password: bring it to
    the site as you would a key.
    """
    check_account(name)
    home.prepare()
    home.tell(hosts=host, listen=listen)
    home.settings().locators  # noqa: B018 - raises: before there is an account whose file nobody could use
    home.change_accounts(lambda found: found.add(name, new_password()))
    say_secret(home.account_file(name).write().decode().rstrip())


@click.command()
@click.argument("name")
@_reached
@pass_home
def show_account(home: RouterHome, name: str, host: tuple[str, ...], listen: tuple[str, ...]) -> None:
    """Print the file of the account NAME again, with the routers of now.

    NAME is `open` for a router that was started with --open.
    """
    home.prepare()
    home.tell(hosts=host, listen=listen)
    say_secret(home.account_file(name).write().decode().rstrip())


@click.command("list")
@flag("--json as_json", "a line of JSON")
@pass_home
def list_accounts(home: RouterHome, *, as_json: bool) -> None:
    """List the accounts."""
    names = home.accounts().names
    say_result(as_json, {"accounts": list(names)}, names)
    if not names and not as_json:
        note("nobody has an account: rossec router accounts add NAME > NAME.account")


@click.command()
@click.argument("names", metavar="NAME...", nargs=-1, required=True)
@json_result(pass_home)
def remove_account(home: RouterHome, names: tuple[str, ...]) -> None:
    """Take the account NAME away; a router that runs cuts its relay off within a second.

    Do it at each router of the operator.
    """
    names = unique(names)
    batch = Batch(len(names), "name")
    for name in names:
        with batch.item(name):
            home.change_accounts(methodcaller("remove", name))
            say(f"the account {name} is no more")
    batch.finish()


@click.command()
@pass_home
def share(home: RouterHome) -> None:
    """Write what another router of the operator needs to join.

    For example: rossec router share > share.json. It holds the key of the routers' authority and
    the passwords of all accounts: bring it to the other host by ssh, and remove it there. Do it again
    when accounts were added or removed.
    """
    say_secret(home.share().write().decode().rstrip())
    note("this holds every password of the routers: keep it to yourself")


@click.command()
@click.argument("file", type=click.Path(path_type=Path, dir_okay=False, allow_dash=True))
@option("--host=NAME", "as of rossec router", multiple=True)
@json_result(pass_home)
def take(home: RouterHome, file: Path, host: tuple[str, ...]) -> None:
    """Take over FILE of `share` here, and join that router.

    That is its authority, its accounts and its address. FILE is - for standard input. A router that
    runs here takes the accounts over within a second.
    """
    # It becomes the authority of this router: a file that another user can write would choose it.
    if str(file) == "-":
        data = sys.stdin.buffer.read(MAX_SHARE_FILE + 1)
    else:
        missing = ConfigurationError(f"there is no {file}", "it is made by: rossec router share")
        data = files.read_own(file, MAX_SHARE_FILE, missing, link=True)
    home.take(Share.read(data))
    home.tell(hosts=host)
    record(accounts=list(home.accounts().names), joins=list(home.settings().join))
    say(f"accounts: {', '.join(home.accounts().names) or 'none'}; joins {', '.join(home.settings().join)}")


@click.command()
@click.argument("uri", required=False, default="")
@option("--as=LABEL label", "what it is called here", required=True)
@option("--name=NAME master", "the name that master is certified for", default=MASTER, show_default=True)
@option(
    "--domain=LABEL", "the label of its foreign domain, if that is not the site's own label", default=None
)
@option(
    "--via=PEER", "instead of a URI: the site that the relay of this site knows by this label", default=""
)
@json_result(pass_environment)
def add_site(
    environment: Environment, uri: str, label: str, master: str, domain: str | None, via: str
) -> None:
    """Follow the master at URI, or behind the relay's peer PEER, and call it LABEL.

    A label that is that of a trusted domain means a master of that domain. A running master begins
    within a second.
    """
    if bool(uri) == bool(via):
        raise ConfigurationError(
            "a master is followed at a URI or by a relay",
            f"rossec federation add URI --as {label}, or: add --via PEER --as {label}",
        )
    home = _home(environment)
    found = _foreign(home, label) if domain is None else domain
    site = SiteSettings(label, uri, master, found, via=via)
    if not found and master == home.name:
        raise ConfigurationError(
            f"{master} is the master of this host itself",
            "another one of this domain has another name: --name /master/kitchen;"
            " that of another domain is followed once that is trusted: rossec domain accept BUNDLE",
        )

    def put(sites: dict[str, SiteSettings]) -> None:
        if label in sites:
            raise ConfigurationError(
                f"there is a site {label} already: {sites[label].place}", f"rossec federation remove {label}"
            )
        sites[label] = site
        checked_sites(sites.values())

    SiteFile(home.path).change(put)
    record(label=label, uri=uri, via=via, domain=found, master=master)
    say(f"{label} is followed: {display_name(found, master)} {site.place}")


def _home(environment: Environment) -> NodeHome:
    return NodeHome.of(environment.home, own_master(environment.variables))


def _foreign(home: NodeHome, label: str) -> str:
    if not home.path.is_dir():
        return ""
    try:
        anchors = DomainFiles(home, home.anchor()).anchors()
    except CAError as error:
        raise ConfigurationError(
            f"the list of domains of {home.name} is invalid: {error}", "rossec ca publish"
        ) from error
    return "" if anchors.listed(label) is None else label


@click.command()
@click.argument("labels", metavar="LABEL...", nargs=-1, required=True)
@json_result(pass_environment)
def remove_site(environment: Environment, labels: tuple[str, ...]) -> None:
    """Follow LABEL no longer: its names go at once.

    Subscribers here leave its publishers.
    """
    labels = unique(labels)
    batch = Batch(len(labels), "name")
    for label in labels:
        with batch.item(label):
            SiteFile(_home(environment).path).change(partial(_take_out, label, "site"))
            say(f"{label} is followed no longer")
    batch.finish()


@click.command()
@click.argument("label")
@click.argument("pattern")
@flag("--remove removing", "mirror it no longer")
@json_result(pass_environment)
def param(environment: Environment, label: str, pattern: str, *, removing: bool) -> None:
    """Mirror the parameters of LABEL that match PATTERN, read-only.

    They are at /remote/LABEL/... here. PATTERN has the names they have there, for example
    '/robot/**'. This master needs a grant of the right param-get on them, in its home.
    """

    def change(sites: dict[str, SiteSettings]) -> None:
        site = _find(sites, label, "site")
        patterns = [each for each in site.parameters if each != pattern]
        if removing and len(patterns) == len(site.parameters):
            raise ConfigurationError(f"{pattern} of {label} is not mirrored", "rossec federation list")
        sites[label] = replace(site, parameters=(*patterns, *([] if removing else [pattern])))

    SiteFile(_home(environment).path).change(change)
    record(label=label, pattern=pattern, mirrored=not removing)
    say(f"{pattern} of {label} is mirrored{' no longer' if removing else ''}")


@click.command("list")
@flag("--json as_json", "a line of JSON for each")
@pass_environment
def list_sites(environment: Environment, *, as_json: bool) -> None:
    """List the masters to follow, as `rossec federation add` has them.

    Those of the configuration file and those that were heard are in `rossec federation status`.
    """
    sites = list(SiteFile(_home(environment).path).sites())
    for each in sites:
        if as_json:
            say_json(
                {
                    "label": each.label,
                    "uri": each.uri,
                    "master": each.master,
                    "domain": each.domain,
                    "parameters": list(each.parameters),
                    "via": each.via,
                }
            )
            continue
        where = each.uri or each.place
        mirrored = f"  {' '.join(each.parameters)}" if each.parameters else ""
        say(f"{each.label:<16} {display_name(each.domain, each.master)}  {where}{mirrored}")
    if not sites and not as_json:
        note("no master is followed: rossec federation add URI --as LABEL")


def home_of(environment: Environment, directory: Path | None) -> RouterHome:
    """The directory that was given, else that in ROSSEC_HOME."""
    found = environment.home / DIRECTORY if directory is None else directory.absolute()
    return RouterHome(found)
