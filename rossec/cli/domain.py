"""`rossec domain`: which foreign domains are trusted, how far, and until when."""

import sys
from collections.abc import Callable, Iterable, Iterator
from contextlib import closing
from pathlib import Path
from typing import Any, Final

import click

from ca import domains
from ca.enrollment import qr
from ca.enrollment.qr import bundle_code, check_code
from ca.errors import NameRefused
from ca.names import MASTER, RELAY, check_label, check_pattern
from ca.store.record import Store
from ca.store.signed_statements import DomainRow, check_domains_apart
from grants.model import ALL_RIGHTS, Right
from rossec import clock, files
from rossec.authority.domain_operations import find_row, living_grants
from rossec.authority.home import AuthorityHome, fingerprint, format_fingerprint
from rossec.authority.service import AuthorityService
from rossec.cli.shared import options
from rossec.cli.shared.context import Environment, confirm, now, pass_environment
from rossec.cli.shared.service import pass_service, publish_list
from rossec.errors import ConfigurationError
from rossec.terminal import note, note_picture, printable, record, say, say_json

# Without these, the masters of two domains cannot follow each other, nor learn of revocations.
OF_MASTERS: Final = (MASTER, f"{MASTER}/*")
OF_RELAYS: Final = (RELAY, f"{RELAY}/*")  # without these no link between sites
EVERYTHING, NOTHING = "everything", "nothing"
MAX_DAYS: Final = 10 * 366
_RIGHTS: Final = {right.label: right for right in Right} | {"all": ALL_RIGHTS}
admit = options.option(
    "--admit=PATTERN", "nodes of it that may connect; its masters and relays may as well", multiple=True
)


@click.command()
@options.option("--out", "write it here, instead of DOMAIN.bundle", type=options.NEW_FILE)
@options.option(
    "--names=PATTERN",
    "your nodes that shall be admitted there",
    multiple=True,
    default=("/**",),
    show_default=True,
)
@options.option("--at=URI masters", "where they reach your master", multiple=True)
@options.duration(
    "--for lifetime",
    "how long it can be accepted",
    days=domains.MAX_TRUST_BUNDLE_LIFETIME // 86400,
    default="7d",
)
@options.flag("--qr picture", "also show its code as a picture, on stderr")
@options.json_result(pass_service)
def bundle(
    service: AuthorityService,
    out: Path | None,
    names: tuple[str, ...],
    masters: tuple[str, ...],
    lifetime: int,
    picture: bool,
) -> None:
    """Write this domain's bundle, for the authority of another one.

    A bundle is no secret, and anybody could make one in your name: let them compare its fingerprint
    with yours by telephone or on paper, or scan its code from your screen.
    """
    home = service.home
    data = service.domains.bundle(names, masters, lifetime)
    target = out or Path(f"{home.domain}.bundle")
    files.replace(target, data, 0o644)
    record(
        domain=home.domain, file=str(target), code=bundle_code(data), fingerprint=fingerprint(home.anchor())
    )
    say(f"bundle of {home.domain}: {target}")
    say(f"fingerprint {fingerprint(home.anchor())}")
    say(f"code {bundle_code(data)}")
    if picture:
        note_picture(qr.terminal(bundle_code(data)))
    note(f"there: rossec domain accept {target.name} --as LABEL")
    note("that lets your nodes in there; for theirs here, accept their bundle: it is two-sided")


def lifetime(default: str | None) -> Callable[..., Any]:
    text = "how long it is trusted, from now on"
    return options.duration("--for lifetime", text, days=MAX_DAYS, default=default)


def fresh(default: str | None) -> Callable[..., Any]:
    text = "how old its last word on its revocations may be"
    return options.duration("--fresh", text, days=domains.MOST_FRESH // 86400, default=default)


def rules(command: Callable[..., Any]) -> Callable[..., Any]:
    for name, what in (
        ("--import=RULE imported", "taken from it into the graph here"),
        ("--export=RULE exported", "shown to it, where grants allow it too"),
    ):
        command = options.option(name, f"{what}: PATTERN RIGHT[,RIGHT]", multiple=True)(command)
    return command


@click.command()
@click.argument("bundle", type=options.FILE)
@options.option("--as label", "what it is called here, for example hospital")
@admit
@fresh("1h")
@lifetime("365d")
@rules
@options.option("--code", "the code that its authority shows (rossec domain bundle)")
@options.image
@options.option("--fingerprint expected", "the fingerprint that its authority has told you")
@options.master_uri
@options.yes
@options.json_result(pass_service)
def accept(
    service: AuthorityService,
    bundle: Path,
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
    """Trust the domain of BUNDLE, as far as these options say.

    Shows its fingerprint, which you compare with the one its authority shows, and asks. Its nodes
    that are admitted may then connect and say who they are; what they may do is up to grants. By
    default the names are admitted that the bundle asks for. Accepting it again changes the terms.
    """
    # 1. The bundle is the one that was meant, as far as that can be checked here. It is signed by the root in
    # it, so by anybody: only the code or fingerprint of the other screen decides (attack `foreign-bundle`).
    home, data = service.home, files.read(bundle, domains.MAX_TRUST_BUNDLE)
    if image is not None:
        from rossec.enrollment import code_in_file  # noqa: PLC0415 - carries the network of an enrollment

        code = code_in_file(image, sys.stdin.buffer)
    if code is not None:
        check_code(code, data)
    found = domains.open_bundle(data, now())
    shown = format_fingerprint(found.anchor.thumbprint)
    if expected is not None and "".join(expected.lower().split()) != shown.replace(" ", ""):
        raise ConfigurationError(
            f"the fingerprint of the bundle is {shown}",
            "it is another authority's: ask yours for its bundle again, and trust no other",
        )
    domain = domains.ForeignDomain(
        found.anchor.domain,
        _label(home, found, label),
        found.root,
        admitted(admit or found.names),
        check_fresh(fresh),
        now() + lifetime,
        read_rules(exported) if exported else None,
        read_rules(imported) if imported else None,
    )
    # 2. What would be refused when it is signed, before a person compares and answers.
    if domain.domain == home.domain:
        raise ConfigurationError(
            f"this is the bundle of {home.domain}, the own domain",
            "accept the bundle that the other authority wrote",
        )
    for row in home.store().domains.accepted():
        # A domain is its root key: another one must not inherit its grants (attack `taken-label`).
        check_domains_apart(row, domain.domain, domain.label, domain.anchor.thumbprint)
    # 3. A person compares.
    _show(home, domain, found, is_checked=code is not None or expected is not None)
    confirm("trust this domain so far?", yes=yes)
    listed = service.domains.accept(domain)
    record(**as_json(domain), list=listed.seq)
    say(f"{domain.domain} is trusted as {domain.label} (list of domains {listed.seq})")
    note(f"this is one way: until {domain.label} accepts you too, connections with it fail there")
    note(f"  here: rossec domain bundle --out {home.domain}.bundle")
    note(f"  there: rossec domain accept {home.domain}.bundle --as LABEL")
    for uri in found.masters[:1]:
        note(printable(f"your master follows theirs: rossec federation add {uri} --as {domain.label}"))
    note(f"its nodes may do nothing yet: rossec grant sign {domain.label}:/NODE --certificate FILE")
    publish_domains(service)


def _label(home: AuthorityHome, bundle: domains.TrustBundle, given: str | None) -> str:
    if given is not None:
        return check_label(given)
    domain = bundle.anchor.domain
    for row in home.store().domains.accepted():
        if row.domain == domain:
            return row.label
    try:
        return check_label(domain.replace("-", "_").partition(".")[0])
    except NameRefused:
        raise ConfigurationError(f"domain {domain} needs a name here", "for example: --as hospital") from None


def admitted(patterns: Iterable[str]) -> tuple[str, ...]:
    """The patterns that are admitted: those given, masters and relays; each once, sorted."""
    # Sorted and once: the same terms are the same octets.
    return tuple(sorted({*map(check_pattern, patterns), *OF_MASTERS, *OF_RELAYS}))


def check_fresh(seconds: int) -> int:
    if seconds < domains.LEAST_FRESH:
        raise ConfigurationError(
            f"--fresh {seconds}s is too short", f"masters ask every 10 s: at least {domains.LEAST_FRESH}s"
        )
    return seconds


def read_rules(texts: tuple[str, ...]) -> tuple[domains.NameRights, ...] | None:
    """The rules of an export or import; None: no rule, and so no limit."""
    if texts == (EVERYTHING,):
        return None
    return () if texts == (NOTHING,) else tuple(sorted(map(_rule, texts)))


def _rule(text: str) -> domains.NameRights:
    pattern, _, listed = text.strip().partition(" ")
    bits = Right(0)
    for label in listed.replace(",", " ").split():
        if label not in _RIGHTS:
            raise ConfigurationError(f"{label!a} is not a right", f"one of {', '.join(_RIGHTS)}")
        bits |= _RIGHTS[label]
    if not bits:
        raise ConfigurationError(
            f"{text!a} is not a pattern and its rights",
            "as in '/robot/** subscribe', '/door/open call'; or everything, or nothing",
        )
    return check_pattern(pattern), int(bits)


def _show(
    home: AuthorityHome, domain: domains.ForeignDomain, bundle: domains.TrustBundle, *, is_checked: bool
) -> None:
    say(printable(f"domain {domain.domain}, here {domain.label}:/... and /remote/{domain.label}"))
    for line in lines(domain):
        say(printable(line))
    for uri in bundle.masters:
        say(printable(f"  its master is at {uri}"))
    for row in home.store().domains.accepted():
        if row.domain == domain.domain:
            say("  it is trusted already: these terms replace those of before")
    say(
        "  this is the bundle that was meant"
        if is_checked
        else "  no code was checked: compare the fingerprint with the one its authority shows"
    )


def lines(terms: domains.ForeignDomain) -> Iterator[str]:
    yield f"  fingerprint {fingerprint(terms.anchor)}"
    yield f"  admits {_admitted(terms.admitted)}"
    yield f"  until {clock.format_time(terms.until)}"
    yield f"  its word on its revocations may be {duration(terms.fresh)} old"
    for what, given in (("shown to it", terms.exported), ("taken from it", terms.imported)):
        if given is None:
            yield f"  {what}: whatever grants allow"
        else:
            said = (f"{pattern} ({Right(bits).label})" for pattern, bits in given)
            yield f"  {what}: {', '.join(said) or NOTHING}"


def _admitted(patterns: tuple[str, ...]) -> str:
    kinds = {"masters": OF_MASTERS, "relays": OF_RELAYS}
    nodes = [each for each in patterns if each not in {*OF_MASTERS, *OF_RELAYS}]
    whole = [word for word, names in kinds.items() if {*names} <= {*patterns}]
    return (", ".join(nodes) or "no node") + (f", and its {' and '.join(whole)}" if whole else "")


def duration(seconds: int) -> str:
    """Seconds as an option takes them: `1h`, `90s`."""
    for size, unit in ((86400, "d"), (3600, "h"), (60, "m")):
        if seconds % size == 0:
            return f"{seconds // size}{unit}"
    return f"{seconds}s"


def as_json(terms: domains.ForeignDomain) -> dict[str, Any]:
    return {
        "label": terms.label,
        "domain": terms.domain,
        "fingerprint": terms.anchor.thumbprint.hex(),
        "admitted": [*terms.admitted],
        "fresh": terms.fresh,
        "until": terms.until,
        "exported": _rules_json(terms.exported),
        "imported": _rules_json(terms.imported),
    }


def _rules_json(given: tuple[domains.NameRights, ...] | None) -> list[dict[str, Any]] | None:
    if given is None:
        return None
    return [{"pattern": pattern, "rights": [right.label for right in Right(bits)]} for pattern, bits in given]


def publish_domains(service: AuthorityService) -> None:
    record(published=False)
    service.publish_domains()
    say("the master has the new list of domains", published=True)


@click.command()
@click.argument("label")
@admit
@fresh(None)
@lifetime(None)
@rules
@options.master_uri
@options.yes
@options.json_result(pass_service)
def limit(
    service: AuthorityService,
    label: str,
    admit: tuple[str, ...],
    fresh: int | None,
    lifetime: int | None,
    exported: tuple[str, ...],
    imported: tuple[str, ...],
    yes: bool,
) -> None:
    """Change how far, and until when, the domain LABEL is trusted.

    What is not given stays as it is. A RULE is a pattern and rights, as in '/robot/** subscribe';
    the rules given replace those of before; `everything` is whatever grants allow. Where the
    admitted names change, the domain's connections are cut and made anew.
    """
    changes: dict[str, Any] = {}
    if admit:
        changes["admitted"] = admitted(admit)
    if fresh is not None:
        changes["fresh"] = check_fresh(fresh)
    if lifetime is not None:
        changes["until"] = now() + lifetime
    if exported:
        changes["exported"] = read_rules(exported)
    if imported:
        changes["imported"] = read_rules(imported)
    if not changes:
        raise ConfigurationError("nothing is changed", "--admit, --fresh, --for, --export, --import")
    new = service.domains.changed(label, **changes)
    say(f"domain {new.domain}, here {label}")
    for line in lines(new):
        say(printable(line))
    confirm("trust it so far?", yes=yes)
    listed = service.domains.limit(label, **changes)
    say(f"changed (list of domains {listed.seq})", **as_json(new), list=listed.seq)
    publish_domains(service)


@click.command()
@click.argument("label")
@options.reason
@options.flag("--revoke-grants", "also revoke every grant that was signed for its nodes")
@options.master_uri
@options.json_result(pass_service)
def remove(service: AuthorityService, label: str, reason: str, revoke_grants: bool) -> None:
    """Trust the domain LABEL no more, and cut its connections.

    The other side goes on trusting this one until it removes it as well.
    """
    removed = service.domains.remove(label, reason, revoke_grants=revoke_grants)
    record(domain=removed.row.domain, label=label, revoked=len(removed.revoked))
    say(f"{removed.row.domain} is not trusted any more, nor called {label}")
    if removed.revoked:
        say(f"revoked {len(removed.revoked)} grants for its nodes")
    else:
        with closing(service.home.store()) as store:
            count = len(living_grants(store, label, now()))
        if count:
            note(f"{count} grants for its nodes would hold again if it is accepted as {label}")
            note("revoke those you do not want: rossec grant list, rossec grant revoke ID")
    note("there you may be trusted still: at its authority, rossec domain remove LABEL")
    if removed.revoked:
        publish_list(service)
    else:
        publish_domains(service)


@click.command("list")
@options.flag("--all everything", "also those that were removed")
@options.flag("--json in_json", "one line of JSON")
@pass_environment
def list_(environment: Environment, everything: bool, in_json: bool) -> None:
    """List the foreign domains that are trusted."""
    with closing(AuthorityHome.at(environment.home).store()) as store:
        rows = store.domains.accepted()
        if everything:
            rows = list({(row.label, row.root): row for row in store.domains.all()}.values())
        states = [(row, _state(store, row)) for row in rows]
    none = "no foreign domains" if everything else "no foreign domain is trusted"
    lines = [
        printable(f"{row.label}  {row.domain}  until {clock.format_time(row.read().until)}  {state}")
        for row, state in states
    ]
    document = [{**as_json(row.read()), "state": state} for row, state in states]
    options.say_result(in_json, document, lines or [none])


@click.command()
@click.argument("label")
@options.flag("--json in_json", "one line of JSON")
@pass_environment
def show(environment: Environment, label: str, in_json: bool) -> None:
    """Show how far the domain LABEL is trusted."""
    with closing(AuthorityHome.at(environment.home).store()) as store:
        row = find_row(store, label)
        held, state = row.read(), _state(store, row)
        grants = len(living_grants(store, label, now()))
        reason, ended = store.domains.ends().get(row.number, ("", 0))
    if in_json:
        shown = {**as_json(held), "state": state, "grants": grants}
        say_json({**shown, "since": row.at, "ended": ended or None, "reason": reason})
        return
    say(printable(f"domain {row.domain}, here {label}: {state}"))
    for line in lines(held):
        say(printable(line))
    say(f"  {grants} grants for its nodes are in force or can be renewed")
    say(f"  these terms since {clock.format_time(row.at)}")
    if ended:
        say(printable(f"  removed {clock.format_time(ended)}{f': {reason}' * bool(reason)}"))
    else:
        say("  whether it trusts this domain too, the master knows: rossec federation status")


def _state(store: Store, row: DomainRow) -> str:
    if row.number not in {each.number for each in store.domains.accepted()}:
        return "removed"
    return "trusted" if now() < row.read().until else "its time is over"
