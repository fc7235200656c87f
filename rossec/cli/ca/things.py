"""`rossec ca thing | things`: what the authority says of constrained things."""

import contextlib
from pathlib import Path
from typing import Any, Final

import click

from ca.authority import DAY, MAX_LIFETIME
from ca.certificates import check_request
from ca.enrollment import qr
from ca.things.credentials import Credential, ThingKey, read_ccs, read_description
from ca.things.statement import PSK, ThingStatement
from rossec import files
from rossec.authority.home import AuthorityHome, format_fingerprint
from rossec.authority.service import AuthorityService
from rossec.authority.thing_operations import SignedThing, ThingOrder
from rossec.authority.thing_records import IN_FORCE, OTHER_KEY, ThingState, states
from rossec.cli.ca.sign import write_identity
from rossec.cli.shared import options
from rossec.cli.shared.context import Duration, Environment, confirm, now, pass_environment
from rossec.cli.shared.outright import give_outright
from rossec.cli.shared.results import json_result
from rossec.cli.shared.service import pass_service, publish_list, remind_to_publish
from rossec.clock import format_time
from rossec.errors import ConfigurationError
from rossec.terminal import printable, record, say, say_json

_MAX_DAYS: Final = 3650
_MAX_REQUEST: Final = 16 * 1024
_MAX_CREDENTIAL: Final = 4096
_ONE: Final = "give --key FILE, --psk FILE or --renew"
_SHOWN: Final = (IN_FORCE, OTHER_KEY)


@click.command()
@click.argument("name")
@click.option("--border", metavar="NAME", help="the border router that serves it")
@click.option("--key", "ccs", type=options.FILE, help="its credential: a CCS, as CBOR")
@click.option(
    "--psk", "description", type=options.FILE,
    help="what `rossec border add NAME --psk` wrote about its secret",
)  # fmt: skip
@click.option("--renew", is_flag=True, help="say the same again")
@click.option(
    "--request", type=options.FILE, help="sign this request, of the node that stands for it, too"
)
@click.option("--code", help="text of the code on the thing's label")
@click.option(
    "--replace", "replaced", multiple=True, metavar="NAME",
    help="end what is said of NAME: it was renamed or moved, or its device is another one",
)  # fmt: skip
@click.option(
    "--for", "lifetime", type=Duration(_MAX_DAYS), default="365d", show_default=True,
    help="how long this is so",
)  # fmt: skip
@click.option(
    "--identity-for", "identity_lifetime", type=Duration(MAX_LIFETIME // DAY), default="30d",
    show_default=True, help="how long the identity lasts",
)  # fmt: skip
@click.option("--out", type=click.Path(path_type=Path, dir_okay=False), help="where to write it")
@click.option("--yes", is_flag=True, help="do not ask")
@options.master_uri
@json_result()
@pass_service
def thing(service: AuthorityService, name: str, yes: bool, renew: bool, **given: Any) -> None:
    """State that the thing NAME has this key or secret, and which border router serves it.

    The statement is written to a file for the border router, and installed where that is in this
    ROSSEC_HOME. With --request the identity of the node NAME is signed in the same step.
    """
    if renew:
        _check_renewal(given)
        signed = service.renew_thing(name, given["lifetime"])
    else:
        order = _order(name, given)
        _show(service, order, checked=_check_code(given["code"], order.credential))
        confirm(f"sign the statement about {name}?", yes=yes)
        signed = service.sign_thing(order)
    _hand_over(service, signed, given["request"], given["out"])
    if service.has_revoked:
        record(revoked=signed.revoked)
        say(f"what it replaces is revoked ({signed.revoked} entr{_ies(signed.revoked)})")
        publish_list(service)
    else:
        remind_to_publish(service)


@click.command()
@click.option("--all", "everything", is_flag=True, help="also what is renewed, expired or revoked")
@click.option("--json", "in_json", is_flag=True, help="one line of JSON")
@pass_environment
def things(environment: Environment, everything: bool, in_json: bool) -> None:
    """List the things that are stated now, with their border routers."""
    with contextlib.closing(AuthorityHome.at(environment.home).store()) as store:
        found = [each for each in states(store, now()) if everything or each.state in _SHOWN]
    if in_json:
        say_json([_summary(each) for each in found])
        return
    for each in found:
        say(_line(each))
    if not found:
        say("no things")


def _order(name: str, given: dict[str, Any]) -> ThingOrder:
    if given["border"] is None:
        raise ConfigurationError("which border router serves it?", "give --border NAME")
    request: Path | None = given["request"]
    return ThingOrder(
        name, given["border"], _credential(given["ccs"], given["description"]), given["lifetime"],
        frozenset(given["replaced"]),
        b"" if request is None else files.read(request, _MAX_REQUEST),
        given["identity_lifetime"],
    )  # fmt: skip


def _credential(ccs: Path | None, description: Path | None) -> Credential:
    match ccs, description:
        case Path(), None:
            return read_ccs(files.read(ccs, _MAX_CREDENTIAL))
        case None, Path():
            return read_description(files.read(description, _MAX_CREDENTIAL))
        case _:
            raise ConfigurationError("a thing has a key or a secret", _ONE)


def _check_renewal(given: dict[str, Any]) -> None:
    others = ("border", "ccs", "description", "request", "code", "replaced")
    if any(given[name] for name in others):
        raise ConfigurationError("--renew says the same again, and takes nothing new", _ONE)


def _check_code(code: str | None, credential: Credential) -> bool:
    """Whether a code was given, and fits.

    Raises:
        ConfigurationError: it was made for another credential.
    """
    if code is None:
        return False
    if not qr.parse(code).matches(described(credential)):
        raise ConfigurationError(
            "the code on the label is not that of this credential",
            "take the credential from the thing again, or scan the label of this thing",
        )
    return True


def described(credential: Credential) -> bytes:
    """The octets that a label names: the CCS, or the description of a secret."""
    return credential.ccs if isinstance(credential, ThingKey) else credential.description


def _show(service: AuthorityService, order: ThingOrder, *, checked: bool) -> None:
    what = "key" if isinstance(order.credential, ThingKey) else "secret"
    say(f"{printable(order.name)} at the border router {printable(order.border)}")
    say(f"  {what} {format_fingerprint(order.credential.thumbprint)}")
    say(f"  kid {order.credential.kid.hex()}")
    how = "the code of its label fits" if checked else "no code was checked: compare with its label"
    say(f"  {how}")
    if order.request:
        asked = check_request(order.request, service.home.domain)
        say(f"  and an identity for its node, fingerprint {format_fingerprint(asked.thumbprint)}")


def _hand_over(
    service: AuthorityService, signed: SignedThing, request: Path | None, out: Path | None
) -> None:
    """Write what was signed, and install it where it belongs if that is here."""
    statement, name = signed.statement, signed.statement.name
    target = out or Path(f"{name.lstrip('/').replace('/', '.')}.thing")
    files.replace(target, signed.data, 0o644)
    record(name=name, id=statement.id.hex(), expires=statement.expires, file=str(target))
    say(f"signed {name} until {format_time(statement.expires)}: {target}")
    bundle = target if request is None else write_identity(request, signed.bundle)
    if request is not None:
        record(identity=str(bundle))
        say(f"signed its identity: {bundle}")
    path = service.store_thing(signed.data, signed.bundle)
    if path is not None:
        record(border=str(path))
        say(f"given to its border router in {path}")
    else:
        more = "" if request is None else f" {bundle}"
        say(f"next, on its border router: rossec border install {target}{more}")
    if request is not None:
        give_outright(service, name)


def _line(each: ThingState) -> str:
    found = each.row.read()
    kind = "secret" if found.kind == PSK else "key"
    return "  ".join([
        each.row.name, f"at {each.row.border}", f"until {format_time(each.row.expires)}",
        f"{kind} {format_fingerprint(found.credential.thumbprint)}",
        *[each.state] * (each.state != IN_FORCE),
    ])  # fmt: skip


def _summary(each: ThingState) -> dict[str, object]:
    found: ThingStatement = each.row.read()
    return {
        "name": found.name,
        "border": each.row.border,
        "border_key": found.border.hex(),
        "class": found.kind,
        "kid": found.credential.kid.hex(),
        "key": found.credential.thumbprint.hex(),
        "not_before": found.not_before,
        "expires": found.expires,
        "id": found.id.hex(),
        "state": each.state,
    }


def _ies(count: int) -> str:
    return "y" if count == 1 else "ies"
