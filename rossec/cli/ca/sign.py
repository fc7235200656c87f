"""`rossec ca sign | import | thing | things`, `rossec ca intermediate`: what is signed from files."""

import contextlib
from collections.abc import Callable
from pathlib import Path
from typing import Any, Final

import click

from ca.authority import DAY, MAX_LIFETIME
from ca.certificates import check_intermediate_request, from_pem
from ca.enrollment import qr
from ca.keys.signing import thumbprint
from ca.names import check_wildcard, spiffe_id
from ca.svid import check_request
from ca.things import PSK, Credential, ThingKey, ThingStatement, read_ccs, read_description
from rossec import files
from rossec.authority import renewals
from rossec.authority.home import AuthorityHome, format_fingerprint
from rossec.authority.service import AuthorityService, SignedThing, ThingOrder
from rossec.authority.signing import IN_FORCE, OTHER_KEY, ThingState, states
from rossec.cli.shared import options, passphrase
from rossec.cli.shared.context import Environment, confirm, now, pass_environment
from rossec.cli.shared.options import FILE, NEW_FILE, Batch, duration, flag, json_result, option, say_result
from rossec.cli.shared.service import (
    give_outright,
    pass_service,
    publish_if_revoked,
    publish_list,
    remind_to_publish,
)
from rossec.clock import format_time
from rossec.errors import ConfigurationError
from rossec.terminal import printable, record, say

identity_lifetime = duration(
    "--for lifetime", "how long the identity lasts", days=MAX_LIFETIME // DAY, default="30d"
)
anonymous = flag("--anonymous", "for anonymous nodes too: /rviz also as /rviz_1234_1700000000000")
_MAX_REQUEST: Final = 16 * 1024
_MAX_CREDENTIAL: Final = 4096
_ONE: Final = "give --key FILE, --psk FILE or --renew"


def replace_key(*, multiple: bool = False) -> Callable[[Callable[..., Any]], Callable[..., Any]]:
    return option(
        "--replace-key=NAME replaced",
        "let the known name NAME come with another key; revokes the old one",
        multiple=multiple,
    )


@click.command()
@click.argument("requests", nargs=-1, required=True, type=FILE)
@option("--code codes", "text of the QR code the node shows; one per request", multiple=True)
@identity_lifetime
@replace_key(multiple=True)
@anonymous
@options.master_uri
@options.yes
@json_result(pass_service)
def sign(
    service: AuthorityService,
    requests: tuple[Path, ...],
    codes: tuple[str, ...],
    lifetime: int,
    replaced: tuple[str, ...],
    anonymous: bool,
    yes: bool,
) -> None:
    """Sign the identity requests in REQUESTS, after showing them.

    Each certificate is written beside its request, as node.pem. With --code the request must be the
    one the code was made for: scan or paste it from the node's own screen. Where one of several is
    refused the others are signed, and the exit code is 1.
    """
    home, batch = service.home, Batch(len(requests))
    read = [(path, read_request(path)) for path in requests]
    if codes:
        # The code authenticates the request, whoever carried it here (attack `enrollment-middle`).
        parsed = [qr.parse(text) for text in codes]
        for code in parsed:
            code.check_time(now())
        unmatched = [data for _, data in read if not any(code.matches(data) for code in parsed)]
        if unmatched or len(parsed) != len(read):
            raise ConfigurationError(
                "a request does not fit the codes: it was changed on its way, or is another node's",
                "scan the code again from the screen of the node itself",
            )
    # All are shown, then one question, then all are signed: nobody answers for what he has not seen.
    checked: list[tuple[Path, bytes, str]] = []
    for path, data in read:
        with batch.item(path, last=False):
            request = check_request(data, home.domain, wildcard=anonymous)
            compare = "no code was checked: compare the fingerprint with the one the node shows"
            say(f"{printable(spiffe_id(home.domain, request.name))} asks for an identity ({path})")
            say(f"  fingerprint {format_fingerprint(request.thumbprint)}")
            say(f"  {'its code fits' if codes else compare}")
            if anonymous:
                warn_of_wildcard(request.name)
            checked.append((path, data, request.name))
    if checked:
        what = "this identity" if len(checked) == 1 else f"these {len(checked)} identities"
        confirm(f"sign {what}?", yes=yes)
        service.unlock()
        for path, data, name in checked:
            with batch.item(path):
                # A known name with another key revokes the old one: only where it was named, never for all.
                key = name if name in replaced else None
                bundle = service.identities.issue(
                    data, lifetime, replace_key=key, wildcard=anonymous, source="file"
                )
                target = write_identity(path, bundle)
                say(f"signed {name}: {target}", name=name, identity=str(target))
                give_outright(service, name)
        publish_if_revoked(service)
    batch.finish()


def warn_of_wildcard(name: str) -> None:
    check_wildcard(name)
    say(f"  it may run as any number of nodes, under every name that begins with {name}_")
    say("  all of them have one key and the same grants, and are revoked together")


def read_request(path: Path, most: int = _MAX_REQUEST) -> bytes:
    """The octets of a request, at most one more than `most`: it is refused where it is checked."""
    with path.open("rb") as stream:
        return stream.read(most + 1)


def write_identity(request: Path, bundle: bytes) -> Path:
    """Write an identity beside its request; returns where."""
    name = "node.pem" if request.name == "node.csr" else f"{request.stem}.pem"
    target = request.with_name(name)
    files.replace(target, bundle, 0o644)
    return target


@click.command()
@click.argument("domain")
@passphrase.option
@json_result(pass_environment)
def request_intermediate(environment: Environment, domain: str, passphrase_file: Path | None) -> None:
    """On the host: make its key and a request, to carry to the root of DOMAIN."""
    secret = passphrase.choose(passphrase_file, environment.variables)
    path = renewals.begin(environment.home, domain, secret)
    key = check_intermediate_request(path.read_bytes(), domain)
    record(domain=domain, file=str(path), key=thumbprint(key).hex())
    say(f"request of an intermediate of {domain}: {path}")
    say(f"fingerprint {format_fingerprint(thumbprint(key))}")
    say(f"next, at the root: rossec ca intermediate sign {path} --may renew")


@click.command()
@click.argument("request", type=FILE)
@option(
    "--may",
    "renew identities that exist, or enroll new nodes as well",
    required=True,
    type=click.Choice(["renew", "enroll"]),
)
@duration("--for lifetime", "how long it may sign", days=MAX_LIFETIME // DAY, default="90d")
@options.yes
@json_result(pass_service)
def sign_intermediate(service: AuthorityService, request: Path, may: str, lifetime: int, yes: bool) -> None:
    """At the root: sign REQUEST of a host, and set what it may do."""
    domain = service.home.domain
    data = files.read(request, _MAX_REQUEST)
    key = check_intermediate_request(data, domain)
    # A policy in its certificate, which its own host obeys: a verifier cannot tell a renewal (decision 0009).
    powers = "renew identities" + (" and enroll new nodes" if may == "enroll" else "")
    say(f"an intermediate of {domain} that may {powers} until {format_time(now() + lifetime)}")
    say(f"  fingerprint {format_fingerprint(thumbprint(key))}")
    confirm("is this the fingerprint its host shows, and sign it?", yes=yes)
    name, bundle = service.identities.sign_intermediate(data, may_enroll=may == "enroll", lifetime=lifetime)
    target = request.with_suffix(".pem")
    files.replace(target, bundle, 0o644)
    say(f"signed {name}: {target}", name=name, file=str(target), key=thumbprint(key).hex(), may=may)
    say(f"to revoke it, with all it signed: rossec ca revoke {name}")
    remind_to_publish(service)


@click.command()
@click.argument("bundle", type=FILE)
@passphrase.option
@json_result(pass_environment)
def install_intermediate(environment: Environment, bundle: Path, passphrase_file: Path | None) -> None:
    """On the host: install BUNDLE, which the root signed."""
    data = files.read(bundle, _MAX_REQUEST)
    secret = passphrase.read(passphrase_file, environment.variables)
    found = renewals.install(environment.home, data, secret, now())
    powers = "renew and enroll" if found.may_enroll else "renew"
    say(f"this host may {powers} until {format_time(found.not_after)}", may=powers, expires=found.not_after)


@click.command("import")
@click.argument("bundles", nargs=-1, required=True, type=FILE)
@replace_key(multiple=True)
@options.master_uri
@options.yes
@json_result(pass_service)
def import_(
    service: AuthorityService, bundles: tuple[Path, ...], replaced: tuple[str, ...], yes: bool
) -> None:
    """Record the identities in BUNDLES (node.pem), which an intermediate enrolled or renewed.

    Only then can the root sign grants for these nodes, or revoke them by their names.
    """
    home, batch = service.home, Batch(len(bundles))
    found: list[tuple[Path, bytes]] = []
    for path in bundles:
        with batch.item(path, last=False):
            data = files.read(path, 64 * 1024)
            identity = home.anchor().verify(from_pem(data)[:-1], now())
            say(f"{identity.name} of {home.domain} until {format_time(identity.not_after)} ({path})")
            say(f"  fingerprint {format_fingerprint(identity.thumbprint)}")
            for issuer in identity.issuers:
                say(f"  signed by intermediate/{issuer.hex()[:16]}")
            found.append((path, data))
    if found:
        confirm(f"import {len(found)} of them?", yes=yes)
        service.unlock()
        for path, data in found:
            with batch.item(path):
                identity, new = service.identities.import_bundle(data, replaced)
                say(f"{'imported' if new else 'known already:'} {identity.name}", name=identity.name, new=new)
        publish_if_revoked(service)
    batch.finish()


@click.command()
@click.argument("name")
@option("--border=NAME", "the border router that serves it")
@option("--key ccs", "its credential: a CCS, as CBOR", type=FILE)
@option("--psk description", "what `rossec border add NAME --psk` wrote about its secret", type=FILE)
@flag("--renew", "say the same again")
@option("--request", "sign this request, of the node that stands for it, too", type=FILE)
@option("--code", "text of the code on the thing's label")
@option(
    "--replace=NAME replaced",
    "end what is said of NAME: it was renamed or moved, or its device is another one",
    multiple=True,
)
@duration("--for lifetime", "how long this is so", days=3650, default="365d")
@duration(
    "--identity-for identity_lifetime", "how long the identity lasts", days=MAX_LIFETIME // DAY, default="30d"
)
@option("--out", "where to write it", type=NEW_FILE)
@options.yes
@options.master_uri
@json_result(pass_service)
def thing(service: AuthorityService, name: str, yes: bool, renew: bool, **given: Any) -> None:
    """State that the thing NAME has this key or secret, and which border router serves it.

    The statement is written to a file for the border router, and installed where that is in this
    ROSSEC_HOME. With --request the identity of the node NAME is signed in the same step.
    """
    if renew:
        if any(given[name] for name in ("border", "ccs", "description", "request", "code", "replaced")):
            raise ConfigurationError("--renew says the same again, and takes nothing new", _ONE)
        signed = service.things.renew(name, given["lifetime"])
    else:
        if given["border"] is None:
            raise ConfigurationError("which border router serves it?", "give --border NAME")
        request: Path | None = given["request"]
        match given["ccs"], given["description"]:
            case Path() as ccs, None:
                credential: Credential = read_ccs(files.read(ccs, _MAX_CREDENTIAL))
            case None, Path() as description:
                credential = read_description(files.read(description, _MAX_CREDENTIAL))
            case _:
                raise ConfigurationError("a thing has a key or a secret", _ONE)
        order = ThingOrder(
            name,
            given["border"],
            credential,
            given["lifetime"],
            frozenset(given["replaced"]),
            b"" if request is None else files.read(request, _MAX_REQUEST),
            given["identity_lifetime"],
        )
        # The label's code names the credential: a swapped file would give the name to another device.
        if given["code"] is not None and not qr.parse(given["code"]).matches(described(credential)):
            raise ConfigurationError(
                "the code on the label is not that of this credential",
                "take the credential from the thing again, or scan the label of this thing",
            )
        what = "key" if isinstance(order.credential, ThingKey) else "secret"
        say(f"{printable(order.name)} at the border router {printable(order.border)}")
        say(f"  {what} {format_fingerprint(order.credential.thumbprint)}")
        say(f"  kid {order.credential.kid.hex()}")
        compare = "no code was checked: compare with its label"
        say(f"  {compare if given['code'] is None else 'the code of its label fits'}")
        if order.request:
            asked = check_request(order.request, service.home.domain)
            say(f"  and an identity for its node, fingerprint {format_fingerprint(asked.thumbprint)}")
        confirm(f"sign the statement about {name}?", yes=yes)
        signed = service.things.sign(order)
    _hand_over(service, signed, given["request"], given["out"])
    if service.has_revoked:
        record(revoked=signed.revoked)
        say(f"what it replaces is revoked ({signed.revoked} entr{'y' if signed.revoked == 1 else 'ies'})")
        publish_list(service)
    else:
        remind_to_publish(service)


def described(credential: Credential) -> bytes:
    """The octets that a label names: the CCS, or the description of a secret."""
    return credential.ccs if isinstance(credential, ThingKey) else credential.description


def _hand_over(
    service: AuthorityService, signed: SignedThing, request: Path | None, out: Path | None
) -> None:
    statement, name = signed.statement, signed.statement.name
    target = out or Path(f"{name.lstrip('/').replace('/', '.')}.thing")
    files.replace(target, signed.data, 0o644)
    record(name=name, id=statement.id.hex(), expires=statement.expires, file=str(target))
    say(f"signed {name} until {format_time(statement.expires)}: {target}")
    bundle = target if request is None else write_identity(request, signed.bundle)
    if request is not None:
        say(f"signed its identity: {bundle}", identity=str(bundle))
    path = service.things.store(signed.data, signed.bundle)
    if path is not None:
        say(f"given to its border router in {path}", border=str(path))
    else:
        more = "" if request is None else f" {bundle}"
        say(f"next, on its border router: rossec border install {target}{more}")
    if request is not None:
        give_outright(service, name)


@click.command()
@flag("--all everything", "also what is renewed, expired or revoked")
@flag("--json in_json", "one line of JSON")
@pass_environment
def things(environment: Environment, everything: bool, in_json: bool) -> None:
    """List the things that are stated now, with their border routers."""
    with contextlib.closing(AuthorityHome.at(environment.home).store()) as store:
        found = [each for each in states(store, now()) if everything or each.state in (IN_FORCE, OTHER_KEY)]
    say_result(in_json, [_summary(each) for each in found], map(_line, found) if found else ["no things"])


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


def _line(each: ThingState) -> str:
    found = each.row.read()
    kind = "secret" if found.kind == PSK else "key"
    return "  ".join(
        [
            each.row.name,
            f"at {each.row.border}",
            f"until {format_time(each.row.expires)}",
            f"{kind} {format_fingerprint(found.credential.thumbprint)}",
            *[each.state] * (each.state != IN_FORCE),
        ]
    )
