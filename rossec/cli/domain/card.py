"""`rossec domain card`: the file that another authority accepts, and the code that fits it."""

from pathlib import Path

import click

from ca.domains.card_codes import card_code
from ca.domains.cards import MAX_LIFETIME
from ca.enrollment import qr
from rossec import files
from rossec.authority.home import fingerprint
from rossec.authority.service import AuthorityService
from rossec.cli.shared.context import Duration
from rossec.cli.shared.results import json_result
from rossec.cli.shared.service import pass_service
from rossec.terminal import note, note_picture, record, say


@click.command()
@click.option(
    "--out", type=click.Path(path_type=Path, dir_okay=False),
    help="write it here, instead of DOMAIN.card",
)  # fmt: skip
@click.option(
    "--names", multiple=True, metavar="PATTERN", default=("/**",), show_default=True,
    help="your nodes that shall be admitted there",
)  # fmt: skip
@click.option("--at", "masters", multiple=True, metavar="URI", help="where they reach your master")
@click.option(
    "--for", "lifetime", type=Duration(MAX_LIFETIME // 86400), default="7d", show_default=True,
    help="how long it can be accepted",
)  # fmt: skip
@click.option("--qr", "picture", is_flag=True, help="also show its code as a picture, on stderr")
@json_result()
@pass_service
def card(
    service: AuthorityService,
    out: Path | None,
    names: tuple[str, ...],
    masters: tuple[str, ...],
    lifetime: int,
    picture: bool,
) -> None:
    """Write this domain's card, for the authority of another one.

    A card is no secret, and anybody could make one in your name: let them compare its fingerprint
    with yours by telephone or on paper, or scan its code from your screen.
    """
    home = service.home
    data = service.domain_card(names, masters, lifetime)
    target = out or Path(f"{home.domain}.card")
    files.replace(target, data, 0o644)
    record(
        domain=home.domain, file=str(target), code=card_code(data),
        fingerprint=fingerprint(home.anchor()),
    )  # fmt: skip
    say(f"card of {home.domain}: {target}")
    say(f"fingerprint {fingerprint(home.anchor())}")
    say(f"code {card_code(data)}")
    if picture:
        note_picture(qr.terminal(card_code(data)))
    note(f"there: rossec domain accept {target.name} --as LABEL")
    note("that lets your nodes in there; for theirs here, accept their card: it is two-sided")
