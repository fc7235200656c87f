"""`rossec ca list | show | renew | revoke | refresh | publish` and `ca log`: the record."""

import base64
from pathlib import Path
from typing import Any

import click

from ca.authority import DAY, MAX_LIFETIME
from ca.certificates import renew_at
from ca.errors import HintedError
from ca.names import is_alias, local_name, shown
from ca.revocation.lists import RevocationList
from ca.store.record import Store
from ca.store.values import CertificateRow, leaf, open_head
from rossec import files, terminal
from rossec.authority import restored_lists
from rossec.authority import signing as things
from rossec.authority.home import AuthorityHome, fingerprint, format_fingerprint
from rossec.authority.service import AuthorityService
from rossec.cli.shared import options
from rossec.cli.shared.context import Environment, now, pass_environment
from rossec.cli.shared.options import FILE, NEW_FILE, Batch, flag, json_result, option, say_result
from rossec.cli.shared.service import pass_service, publish_list, remind_to_publish
from rossec.clock import format_time
from rossec.errors import ConfigurationError
from rossec.home import NodeHome
from rossec.terminal import note, printable, record, say, say_json

_MAX_HEAD = 4096


@click.command("list")
@flag("--all everything", "also what is replaced, expired or revoked")
@flag("--json in_json", "one line of JSON")
@pass_environment
def list_(environment: Environment, everything: bool, in_json: bool) -> None:
    """List the identities that are valid now."""
    found = states(AuthorityHome.at(environment.home).store(), now())
    chosen = [(row, state) for row, state in found if everything or state == "valid"]
    if in_json:
        say_json([as_json(row, state) for row, state in chosen])
        return
    for row, state in chosen:
        say(line(row, state))
    # What is to be done: identities that end soon and were not renewed, and those that are over.
    # Of a name only the newest identity counts: an older one was renewed, or another key replaced it.
    newest = {row.name: (row, state) for row, state in found}.values()
    if soon := [row.name for row, state in newest if state == "valid" and ends_soon(row, now())]:
        note(
            f"not renewed yet, with less than a third of their time left: {', '.join(soon)}"
            " (rossec ca serve renews nodes that run; others: rossec ca renew NAME)"
        )
    if over := [row.name for row, state in newest if state == "expired"]:
        note(f"over: {', '.join(over)} (with key and grants back by: rossec ca renew --expired NAME)")


def states(store: Store, at: int) -> list[tuple[CertificateRow, str]]:
    """Every identity with what it is now: valid, replaced by a newer one, expired, or revoked."""
    with store.database.read_transaction():
        rows, revoked = store.identities.all(), store.revoked_entries()
        in_force = store.identities.with_valid_issuer(rows)
    # In one read transaction: a revocation between two questions would show a key in two states.
    valid = {row.serial for row in in_force if row.thumbprint not in revoked}
    newest = {row.name: row.serial for row in rows if row.serial in valid}

    def state(row: CertificateRow) -> str:
        if row.serial not in valid:
            return "revoked"
        if at > row.not_after:
            return "expired"
        return "valid" if newest[row.name] == row.serial else "replaced"

    return [(row, state(row)) for row in rows]


def as_json(row: CertificateRow, state: str) -> dict[str, Any]:
    return {
        "name": row.name,
        "state": state,
        "anonymous": row.wildcard,
        "not_before": row.not_before,
        "expires": row.not_after,
        "ends_soon": state == "valid" and ends_soon(row, now()),
        "key": row.thumbprint.hex(),
        "serial": f"{row.serial:x}",
    }


def ends_soon(row: CertificateRow, at: int) -> bool:
    return at >= renew_at(row.not_before, row.not_after)


def line(row: CertificateRow, state: str) -> str:
    name = f"{row.name} and {row.name}_*" if row.wildcard else row.name
    until, key = (f"until {format_time(row.not_after)}", f"fingerprint {format_fingerprint(row.thumbprint)}")
    return "  ".join([name, until, key, *[terminal.state(state)] * (state != "valid")])


@click.command()
@click.argument("name", required=False)
@flag("--json in_json", "one line of JSON")
@pass_environment
def show(environment: Environment, name: str | None, in_json: bool) -> None:
    """Show the authority, or everything about the node NAME."""
    home = AuthorityHome.at(environment.home)
    with_states = [(row, state) for row, state in states(home.store(), now()) if name in {None, row.name}]
    if name is not None and not with_states:
        raise ConfigurationError(f"{name} never had an identity here", "see: rossec ca list --all")
    if in_json:
        identities = [as_json(row, state) for row, state in with_states]
        about = {"domain": home.domain, "fingerprint": fingerprint(home.anchor())}
        say_json({**about, "intermediate": home.is_intermediate, "identities": identities})
        return
    say(f"authority of {home.domain} in {home.path}")
    say(f"fingerprint {fingerprint(home.anchor())}")
    for row, state in with_states:
        say(line(row, state))
    for each in things.states(home.store(), now()) if name is not None else ():
        if name in {each.row.name, each.row.border} and each.state == things.IN_FORCE:
            say(f"thing {each.row.name} at {each.row.border}, until {format_time(each.row.expires)}")


@click.command()
@click.argument("names", metavar="NAME...", nargs=-1, required=True)
@options.duration(
    "--for lifetime", "how long the new identity lasts", days=MAX_LIFETIME // DAY, default="30d"
)
@flag("--expired", "also one that is over: it keeps its key, and so its grants")
@option("--out", "where to write it", type=NEW_FILE)
@json_result(pass_service)
def renew(
    service: AuthorityService, names: tuple[str, ...], lifetime: int, expired: bool, out: Path | None
) -> None:
    """Renew the identity of NAME for the key it has; /ca is the authority's own node.

    Nodes that run are renewed by `rossec ca serve`; this is for others. The new identity is written
    to a file to install on the node; where its directory is below this ROSSEC_HOME, and that of
    /ca, it is installed at once. What is revoked never comes back. Where one of several is refused
    the others are renewed, and the exit code is 1.
    """
    names = options.unique(names)
    if out is not None and len(names) > 1:
        raise click.UsageError("--out is of one NAME")
    if len(names) > 1:
        service.unlock()  # a wrong passphrase is no fault of a name
    batch, carried = Batch(len(names), "name"), list[Path]()
    for name in names:
        with batch.item(name):
            if name == things.OWN_NODE:
                expires = service.identities.renew_own_node()
                say(f"renewed {name} until {format_time(expires)}", expires=expires)
            else:
                bundle = service.identities.renew(name, lifetime, expired=expired)
                target = out or Path(f"{name.lstrip('/').replace('/', '.')}.pem")
                files.replace(target, bundle, 0o644)
                say(f"renewed {name}: {target}", file=str(target))
                carried += [] if _install(service, name, bundle) else [target]
    if carried:
        listed = " ".join(map(str, carried))
        where = "their machines" if len(carried) > 1 else "its machine"
        say(f"next, on {where}: rossec node install {listed}")
    remind_to_publish(service)
    batch.finish()


def _install(service: AuthorityService, name: str, bundle: bytes) -> bool:
    home = NodeHome.of(service.rossec_home, name)
    if not (home.path / "node.pem").exists():
        return False
    try:
        home.install(bundle, now())
    except (HintedError, OSError) as error:  # of another key, or of another user
        note(f"not installed in {home.path}: {error}")
        return False
    say(f"installed in {home.path}", installed=str(home.path))
    return True


@click.command()
@options.master_uri
@json_result(pass_service)
def publish(service: AuthorityService) -> None:
    """Give the newest revocation list to the master.

    The passphrase is needed only where something is revoked that is in no signed list yet.
    """
    if count := service.home.count_unlisted(now()):
        note(f"{count} revocation{'s' * (count != 1)} in no signed list yet: it is signed anew")
        service.complete_list()
    record(published=False)
    service.publish()
    say("the master has the newest list", published=True)


@click.command()
@option(
    "--list older",
    "first revoke what this list revokes: a node's, from before a restore that lacked it",
    type=FILE,
)
@options.entries
@options.master_uri
@json_result(pass_service)
def refresh(service: AuthorityService, older: Path | None, entries: Path | None) -> None:
    """Sign the revocation list anew, before it expires, and give it to the master.

    The authority's own node is renewed as well when two thirds of its life are over.
    """
    if older is not None:
        taken = service.take_over_revocations(*restored_lists.read_files(older, entries))
        say(f"{taken} revocations were taken over from {older}")
    listed, renewed = service.refresh()
    record(list=listed.seq, expires=listed.expires, own_identity_expires=renewed)
    if renewed is not None:
        say(f"renewed {things.OWN_NODE} until {format_time(renewed)}")
    say(f"list {listed.seq} holds until {format_time(listed.expires)}")
    publish_list(service)


@click.command()
@click.argument("names", metavar="NAME...", nargs=-1, required=True)
@options.reason
@option(
    "--certificate", "of a node of another domain: revoke the key in this node.pem, and no other", type=FILE
)
@flag(
    "--thing of_thing",
    "revoke what is said of the thing NAME; the node that stands for it keeps its identity",
)
@options.master_uri
@json_result(pass_service)
def revoke(
    service: AuthorityService, names: tuple[str, ...], reason: str, certificate: Path | None, of_thing: bool
) -> None:
    """Revoke the identity of the node NAME, or with --thing the thing NAME, at once.

    Its connections end and its key is never trusted again; to return it needs a new key. With a
    border router its things end as well: it has the keys of their nodes.

    NAME may be one of another domain, as hospital:/rounds/robot3: every key of it that is recorded
    here (by rossec grant sign) is refused in this domain, whatever its own authority says. Where
    one of several is refused the others are revoked, and the exit code is 1.
    """
    names = options.unique(names)
    if certificate is not None and len(names) > 1:
        raise click.UsageError("--certificate is of one NAME")
    if len(names) > 1:
        service.unlock()  # a wrong passphrase is no fault of a name
    batch = Batch(len(names), "name")
    for name in names:
        with batch.item(name):
            if of_thing:
                listed, count = service.things.revoke(name, reason)
                record(statements=count, list=listed.seq)
                said = f"the thing {name}, {count} statement"
            else:
                listed, count = _revoke_node(service, name, reason, certificate)
                record(keys=count, list=listed.seq)
                said = f"{shown(local_name(name))}, {count} key"
            say(f"revoked {said}{'s' * (count != 1)} (list {listed.seq})")
    if batch.done:
        publish_list(service)
    batch.finish()


def _revoke_node(
    service: AuthorityService, name: str, reason: str, certificate: Path | None
) -> tuple[RevocationList, int]:
    local = local_name(name)
    if is_alias(local):
        pem = b"" if certificate is None else files.read(certificate, options.MAX_PEM)
        return service.domains.revoke_foreigner(local, reason, pem)
    if certificate is not None:
        raise ConfigurationError(
            f"{name} is a node of this domain, whose keys are in the record",
            "--certificate is for nodes of other domains: LABEL:/NAME",
        )
    revoked = service.identities.revoke(name, reason)
    for intermediate in service.identities.intermediates():
        note(
            f"{intermediate} may have certified other keys for {shown(local)}, which are not in this record:"
            f" rossec ca import NODE.pem and revoke again, or revoke {intermediate}"
        )
    return revoked


@click.command()
@option("--head heads", "a signed head kept elsewhere (rossec ca log head)", multiple=True, type=FILE)
@flag("--json in_json", "one line of JSON")
@pass_environment
def verify(environment: Environment, heads: tuple[Path, ...], in_json: bool) -> None:
    """Recompute the whole log and compare it with the record and with every signed head.

    Exit code 1 and the number of the first wrong entry, if anything is not as it was written.
    """
    home = AuthorityHome.at(environment.home)
    store = home.store()
    kept = [files.read(path, _MAX_HEAD) for path in heads]
    with options.working("recomputing the log", quiet=in_json):
        # Who owns the file can rewrite all of it, but not a head kept elsewhere (attack `rewritten-record`).
        newest = store.log.audit(home.own_key(), *kept)
    size = store.log.head(now()).size
    if in_json:
        say_json({"entries": size, "signed": newest.size, "at": newest.issued})
        return
    say(f"{size} entries, all as they were written")
    if newest.size:
        say(f"the first {newest.size} are signed, {format_time(newest.issued)}")
    else:
        say("none of them is signed: next, rossec ca log head")
    if not heads:
        note("a head kept elsewhere proves more: the owner of this file could rewrite all of it")


@click.command()
@option("--out", "write it here", type=NEW_FILE)
@json_result(pass_service)
def head(service: AuthorityService, out: Path | None) -> None:
    """Sign the state of the log, to be kept elsewhere."""
    data = service.sign_head()
    remind_to_publish(service)
    size = open_head(data, service.home.own_key()).size
    record(entries=size, head=base64.b64encode(data).decode())
    if out is None:
        say(base64.b64encode(data).decode())
        return
    files.replace(out, data, 0o644)
    say(f"head of {size} entries: {out}", file=str(out))


@click.command()
@option("--entry", "prove that this entry is in the log", type=click.IntRange(0))
@option("--since", "prove that the log continues this signed head", type=FILE)
@pass_environment
def prove(environment: Environment, entry: int | None, since: Path | None) -> None:
    """Print a proof, as JSON, against the newest signed head (RFC 6962)."""
    home = AuthorityHome.at(environment.home)
    if (entry is None) == (since is None):
        raise ConfigurationError("there is nothing to prove, or too much", "--entry N or --since F")
    journal = home.store().log
    heads = journal.heads()
    if not heads:
        raise ConfigurationError("no state of the log was signed yet", "next: rossec ca log head")
    signed = heads[-1]
    newest, tree = open_head(signed, home.own_key()), journal.tree()
    shown: dict[str, Any] = {"size": newest.size, "root": newest.root.hex()}
    if entry is not None:
        content = leaf(journal.entries()[entry]) if entry < len(tree) else b""
        shown |= {"entry": entry, "leaf": content.hex()}
        proof = tree.inclusion(entry, newest.size)
    else:
        old = open_head(files.read(since or Path(), _MAX_HEAD), home.own_key())
        shown |= {"first": old.size, "first_root": old.root.hex()}
        proof = tree.consistency(old.size, newest.size)
    head_text = base64.b64encode(signed).decode()
    say_json({**shown, "proof": [digest.hex() for digest in proof], "head": head_text})


def show_log(environment: Environment, last: int | None, *, in_json: bool) -> None:
    """Show the newest `last` entries, by default all."""
    entries = AuthorityHome.at(environment.home).store().log.entries()[-(last or 0) :]
    words = ((str(one.number), format_time(one.at), one.what, one.subject, one.detail) for one in entries)
    lines = (printable("  ".join(filter(None, each))) for each in words)
    say_result(in_json, [{**entry._asdict(), "digest": entry.digest.hex()} for entry in entries], lines)
