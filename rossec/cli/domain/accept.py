"""`rossec domain accept`: show the card of another domain, ask, and trust it so far."""

import sys
from pathlib import Path

import click

from ca.domains.aliases import check_label
from ca.domains.card_codes import check_code
from ca.domains.cards import MAX_CARD, Card, open_card
from ca.domains.lists import ForeignDomain
from ca.errors import NameRefused
from ca.store.domains import check_apart
from rossec import files
from rossec.authority.home import AuthorityHome, format_fingerprint
from rossec.authority.service import AuthorityService
from rossec.cli.domain import terms
from rossec.cli.domain.delivery import publish_domains
from rossec.cli.shared import options
from rossec.cli.shared.context import confirm, now
from rossec.cli.shared.results import json_result
from rossec.cli.shared.service import pass_service
from rossec.enrollment.scan import code_in_file
from rossec.errors import ConfigurationError
from rossec.terminal import note, printable, record, say


@click.command()
@click.argument("card", type=options.FILE)
@click.option("--as", "label", help="what it is called here, for example hospital")
@terms.admit
@terms.fresh("1h")
@terms.lifetime("365d")
@terms.rules
@click.option("--code", help="the code that its authority shows (rossec domain card)")
@click.option(
    "--image", type=click.Path(path_type=Path, exists=True, dir_okay=False, allow_dash=True),
    help="read the code from this picture; - is standard input",
)  # fmt: skip
@click.option("--fingerprint", "expected", help="the fingerprint that its authority has told you")
@options.master_uri
@click.option("--yes", is_flag=True, help="do not ask")
@json_result()
@pass_service
def accept(
    service: AuthorityService,
    card: Path,
    label: str | None,
    admit: tuple[str, ...],
    fresh: int,
    lifetime: int,
    exported: tuple[str, ...],
    imported: tuple[str, ...],
    code: str | None,
    image: Path | None,
    expected: str | None,
    yes: bool,
) -> None:
    """Trust the domain of CARD, as far as these options say.

    Shows its fingerprint, which you compare with the one its authority shows, and asks. Its nodes
    that are admitted may then connect and say who they are; what they may do is up to grants. By
    default the names are admitted that the card asks for. Accepting it again changes the terms.
    """
    home, data = service.home, files.read(card, MAX_CARD)
    if image is not None:
        code = code_in_file(image, sys.stdin.buffer)
    if code is not None:
        check_code(code, data)
    found = open_card(data, now())
    _check_fingerprint(found, expected)
    domain = ForeignDomain(
        found.anchor.domain, _label(home, found, label), found.root,
        terms.admitted(admit or found.names), terms.check_fresh(fresh), now() + lifetime,
        terms.read_rules(exported) if exported else None,
        terms.read_rules(imported) if imported else None,
    )  # fmt: skip
    _check_apart(home, domain)
    _show(home, domain, found, is_checked=code is not None or expected is not None)
    confirm("trust this domain so far?", yes=yes)
    listed = service.accept_domain(domain)
    record(**terms.as_json(domain), list=listed.seq)
    say(f"{domain.domain} is trusted as {domain.label} (list of domains {listed.seq})")
    _say_what_is_next(home, domain, found)
    publish_domains(service)


def _label(home: AuthorityHome, card: Card, given: str | None) -> str:
    """The label: as given, or the one it has, or its name where that can be one."""
    if given is not None:
        return check_label(given)
    domain = card.anchor.domain
    for row in home.store().domains.accepted():
        if row.domain == domain:
            return row.label
    try:
        return check_label(domain.replace("-", "_").partition(".")[0])
    except NameRefused:
        raise ConfigurationError(
            f"domain {domain} needs a name here", "for example: --as hospital"
        ) from None


def _check_apart(home: AuthorityHome, domain: ForeignDomain) -> None:
    """What would be refused when it is signed, before a person compares and answers."""
    if domain.domain == home.domain:
        raise ConfigurationError(
            f"this is the card of {home.domain}, the own domain",
            "accept the card that the other authority wrote",
        )
    for row in home.store().domains.accepted():
        check_apart(row, domain.domain, domain.label, domain.anchor.thumbprint)


def _check_fingerprint(card: Card, expected: str | None) -> None:
    shown = format_fingerprint(card.anchor.thumbprint)
    if expected is not None and "".join(expected.lower().split()) != shown.replace(" ", ""):
        raise ConfigurationError(
            f"the fingerprint of the card is {shown}",
            "it is another authority's: ask yours for its card again, and trust no other",
        )


def _show(home: AuthorityHome, domain: ForeignDomain, card: Card, *, is_checked: bool) -> None:
    say(printable(f"domain {domain.domain}, here {domain.label}:/... and /remote/{domain.label}"))
    for line in terms.lines(domain):
        say(printable(line))
    for uri in card.masters:
        say(printable(f"  its master is at {uri}"))
    for row in home.store().domains.accepted():
        if row.domain == domain.domain:
            say("  it is trusted already: these terms replace those of before")
    say(
        "  this is the card that was meant"
        if is_checked
        else "  no code was checked: compare the fingerprint with the one its authority shows"
    )


def _say_what_is_next(home: AuthorityHome, domain: ForeignDomain, card: Card) -> None:
    note(f"this is one way: until {domain.label} accepts you too, connections with it fail there")
    note(f"  here: rossec domain card --out {home.domain}.card")
    note(f"  there: rossec domain accept {home.domain}.card --as LABEL")
    for uri in card.masters[:1]:
        follow = f"rossec federation add {uri} --as {domain.label}"
        note(printable(f"your master follows theirs: {follow}"))
    note(f"its nodes may do nothing yet: rossec grant sign {domain.label}:/NODE --certificate FILE")
