"""`rossec relay card | add | list | remove`: with which relays of other sites there are links."""

import secrets
from dataclasses import replace
from functools import partial
from pathlib import Path

import click

from ca.domains.aliases import check_label
from ca.domains.anchors import Anchors
from rossec import files
from rossec.cli.relay.home import known_domains, relay_files
from rossec.cli.shared import options
from rossec.cli.shared.batch import Batch, unique
from rossec.cli.shared.context import Environment, pass_environment
from rossec.cli.shared.results import json_result
from rossec.errors import ConfigurationError
from rossec.overlay.mailboxes import BOX, mailbox
from rossec.overlay.peers import Peer
from rossec.overlay.relay_cards import MAX_CARD, RelayCard
from rossec.terminal import note, printable, record, say, say_json, say_secret

_LISTED = "at the authority: rossec domain accept CARD; then the master has the list, and the relay"


@click.command()
@click.argument("label")
@click.option(
    "--domain", metavar="DOMAIN-LABEL", default=None,
    help="only a relay of this trusted domain may use it; '' for the own domain",
)  # fmt: skip
@pass_environment
def card(environment: Environment, label: str, domain: str | None) -> None:
    """Print the card for the relay LABEL: the mailbox that it alone shall send to.

    The same again each time, and after a change of the seat a new one. Hand it to that relay's
    operator only. Without --domain the card that comes back says of which domain LABEL is.
    """
    store = relay_files(environment)
    own = store.home.anchor().domain
    routers = store.routers()
    if domain:
        _check_listed(known_domains(environment, store.home), domain)

    def put(peers: dict[str, Peer]) -> None:
        peer = peers.setdefault(label, Peer(check_label(label), _new_box(), domain))
        if domain is None or domain == peer.domain:
            return
        if peer.is_complete:
            raise ConfigurationError(
                f"{label} is {peer.shown} already", f"rossec relay remove {label}"
            )
        peers[label] = replace(peer, domain=domain)

    store.change(put)
    box = bytes.fromhex(store.peers()[label].box)
    say_secret(RelayCard(own, store.home.name, mailbox(routers.seat, box)).write().rstrip())
    if not store.peers()[label].is_complete:
        note(f"for the relay {label} alone; there: rossec relay add LABEL FILE")
        note(f"here, its card: rossec relay add {label} FILE")


@click.command()
@click.argument("label")
@click.argument("file", type=options.FILE)
@json_result()
@pass_environment
def add(environment: Environment, label: str, file: Path) -> None:
    """Take the card in FILE of another site's relay, and call it LABEL.

    Links with it are made once it has this relay's card too: rossec relay card LABEL. A running
    relay takes it within a second.
    """
    store = relay_files(environment)
    found = RelayCard.read(files.read(file, MAX_CARD))
    domain = _label_of(known_domains(environment, store.home), found)
    if not domain and found.relay == store.home.name:
        raise ConfigurationError(
            f"this is the card of {found.relay}, the relay of this host itself",
            "add the card that the other relay printed",
        )

    def put(peers: dict[str, Peer]) -> None:
        peer = peers.get(label) or Peer(check_label(label), _new_box())
        if peer.domain is not None and peer.domain != domain:
            raise ConfigurationError(
                f"the card is of domain {found.domain}, and {label} is to be of"
                f" {peer.domain or 'the own one'}",
                f"take the right card, or begin anew: rossec relay remove {label}",
            )
        if peer.is_complete and peer.relay != found.relay:
            raise ConfigurationError(
                f"{label} is {peer.shown} already", f"rossec relay remove {label}"
            )
        peers[label] = replace(peer, domain=domain, relay=found.relay, mailbox=found.mailbox)

    store.change(put)
    record(label=label, domain=domain, relay=found.relay)
    say(f"{label} is {store.peers()[label].shown}")
    note(f"it needs this relay's card too: rossec relay card {label} > FILE, and there: add")


@click.command()
@click.argument("labels", metavar="LABEL...", nargs=-1, required=True)
@json_result()
@pass_environment
def remove(environment: Environment, labels: tuple[str, ...]) -> None:
    """Link with LABEL no longer: its links end at once.

    Its mailbox is gone: a card that was handed out for it is of no use any more.
    """
    labels = unique(labels)
    batch = Batch(len(labels), "name")
    for label in labels:
        with batch.item(label):
            relay_files(environment).change(partial(_take, label))
            say(f"{label} is linked with no longer")
    batch.finish()


def _take(label: str, peers: dict[str, Peer]) -> None:
    if label not in peers:
        raise ConfigurationError(
            f"there is no peer {label[:40]!a}", f"there are: {', '.join(sorted(peers)) or 'none'}"
        )
    del peers[label]


@click.command("list")
@click.option("--json", "as_json", is_flag=True, help="a line of JSON for each")
@pass_environment
def list_(environment: Environment, *, as_json: bool) -> None:
    """List the relays of other sites, as cards have named them."""
    peers = relay_files(environment).peers()
    for label, each in sorted(peers.items()):
        if as_json:
            say_json({"label": label, "domain": each.domain, "relay": each.relay})
        else:
            say(printable(f"{label:<16} {each.shown or 'its card is not here yet'}"))
    if not peers and not as_json:
        note("no relay of another site: rossec relay card LABEL, rossec relay add LABEL FILE")


def _new_box() -> str:
    return secrets.token_hex(BOX)


def _check_listed(anchors: Anchors, label: str) -> None:
    if anchors.listed(label) is None:
        raise ConfigurationError(f"no trusted domain is called {label[:40]!a}", _LISTED)


def _label_of(anchors: Anchors, found: RelayCard) -> str:
    """The label here of the domain of a card; empty: the own one."""
    if found.domain == anchors.own.domain:
        return ""
    listed = anchors.listed_domain(found.domain)
    if listed is None:
        raise ConfigurationError(f"the card is of domain {found.domain}, not trusted here", _LISTED)
    return listed.entry.label
