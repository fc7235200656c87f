"""`rossec ca init | backup | restore`, `ca unlock | lock | status`: the authority's directory, its key."""

import time
from contextlib import closing
from pathlib import Path
from typing import TYPE_CHECKING

import click

from ca.domains import MAX_LIST as MAX_DOMAINS
from ca.encoding import Value
from ca.keys.passphrases import MAX_BACKUP
from ca.keys.private_keys import KeyUri
from rossec import clock, files
from rossec.authority import restored_lists
from rossec.authority.home import AuthorityHome, check_new, enroll_here, fingerprint
from rossec.authority.keyservice.client import KeyServiceClient
from rossec.authority.keyservice.messages import MAX_UNLOCKED
from rossec.cli.shared import options, passphrase
from rossec.cli.shared.context import Environment, UnlockTime, now, pass_environment
from rossec.cli.shared.options import FILE, NEW_FILE, flag, json_result, option, say_result, working
from rossec.clock import format_time
from rossec.errors import ConfigurationError
from rossec.home import NodeHome
from rossec.ros.names import MASTER
from rossec.terminal import note, printable, record, say

if TYPE_CHECKING:
    from rossec.authority import backup as backups

_START = "start it with: rossec ca serve"
_STARTING = 3.0  # seconds: `rossec ca serve &` and `rossec ca unlock` may be pasted together


@click.command()
@click.argument("domain")
@option("--key=URI uri", "make the key in a token: pkcs11:token=T;object=O")
@flag("--master with_master", "enroll /master here too")
@passphrase.option
@json_result(pass_environment)
def init(
    environment: Environment, domain: str, uri: str | None, with_master: bool, passphrase_file: Path | None
) -> None:
    """Create the authority of the trust domain DOMAIN, for example home.

    With --master this host can run its master at once. With --key its key is made in a PKCS#11
    token and never leaves it; the passphrase is its PIN.
    """
    token = None if uri is None else KeyUri.parse(uri)
    master = NodeHome.of(environment.home, MASTER)
    # All that may be refused, before a passphrase is asked for twice and a key is made.
    AuthorityHome.check_new(environment.home)
    if with_master:
        check_new(master)
    if token is None:
        secret = passphrase.choose(passphrase_file, environment.variables)
    else:
        secret = passphrase.read(passphrase_file, environment.variables)
    home = AuthorityHome.create(environment.home, domain, secret, now(), token)
    found = fingerprint(home.anchor())
    say(f"authority of {domain} in {home.path}", domain=domain, path=str(home.path), fingerprint=found)
    say(f"fingerprint {found}")
    if with_master:
        authority = home.unlock(secret)
        with closing(authority.store):
            expires = enroll_here(authority, master, now())
        record(master=str(master.path), expires=expires)
        say(f"/master in {master.path}, until {format_time(expires)}; start it with: rossec master")


@click.command()
@click.argument("file", type=NEW_FILE)
@passphrase.option
@json_result(pass_environment)
def backup(environment: Environment, file: Path, passphrase_file: Path | None) -> None:
    """Write the authority into the new file FILE, encrypted under its passphrase.

    A key in a token is not in the backup; the PIN encrypts this file.
    """
    from rossec.authority import backup as backups  # noqa: PLC0415 - it knows every file, the policy's too

    home = AuthorityHome.at(environment.home)
    secret = passphrase.read(passphrase_file, environment.variables)
    with working("encrypting the backup"):
        home.unlock(secret).store.close()  # a backup that its key does not open is invalid
        files.create(file, backups.back_up(home, secret))
    left = backups.undeclared(home.path)
    found = fingerprint(home.anchor())
    record(domain=home.domain, file=str(file), fingerprint=found, left_out=left)
    for name in left:
        note(f"left out, as it is no file of an authority: {printable(name)}")
    say(f"backup of {home.domain}: {file}")
    say(f"fingerprint {found}")


@click.command()
@click.argument("file", type=FILE)
@option("--over=DOMAIN", "replace the authority of DOMAIN that is here")
@option(
    "--forget=N",
    "lose the N newest log entries, which the backup does not have",
    type=click.IntRange(0),
    default=0,
)
@option("--list newest", "a newer revocation list, for example a node's revocations.cose", type=FILE)
@flag("--without-list", "there is no newer list: what was revoked after the backup is valid again")
@options.entries
@option(
    "--domains",
    "a newer list of domains, for example a node's domains.cose; else no domain is trusted",
    type=FILE,
)
@option(
    "--policy",
    "with --over, where the two differ: which policy stays",
    type=click.Choice(["here", "backup"]),
    default="here",
    show_default=True,
)
@option(
    "--pkcs11-module module",
    "trust this module, where the key is in a token; what the backup names is not loaded",
    type=FILE,
)
@passphrase.option
@json_result(pass_environment)
def restore(
    environment: Environment,
    file: Path,
    over: str | None,
    forget: int,
    newest: Path | None,
    without_list: bool,
    entries: Path | None,
    domains: Path | None,
    policy: str,
    module: Path | None,
    passphrase_file: Path | None,
) -> None:
    """Prove the backup FILE and put its authority back.

    Nothing is overwritten, and nothing newer is lost, unless --over or --forget allows it. What was
    revoked after the backup is not in it: every node has a newer list, revocations.cose beside its
    key, the master the newest. It is wanted first (--list), or the word that there is none.
    """
    from rossec.authority import backup as backups  # noqa: PLC0415 - see above

    # Without a newer list what was revoked since would be valid again: not by leaving an option out
    # (attack `old-backup`).
    if newest is not None and without_list:
        raise click.UsageError("--list and --without-list exclude each other")
    data = files.read(file, MAX_BACKUP)
    listed = (None, None) if newest is None else restored_lists.read_files(newest, entries)
    secret = passphrase.read(passphrase_file, environment.variables)
    with working("proving the backup, entry by entry"):
        found = backups.restore(
            environment.home,
            data,
            secret,
            now(),
            over=over,
            forget=forget,
            newest_list=listed[0],
            entries=listed[1],
            newest_domains=None if domains is None else files.read(domains, MAX_DOMAINS),
            needs_list=not without_list,
            policy_of_backup=policy == "backup",
            module=None if module is None else str(module.absolute()),
        )
    record(
        domain=found.home.domain,
        path=str(found.home.path),
        entries=found.entries,
        fingerprint=fingerprint(found.home.anchor()),
        ended_domains=found.ended_domains,
        revocations=found.restored_revocations,
        ended_phones=bool(found.ended_phones),
        policy=found.policy,
        left_out=list(found.left_out),
    )
    say(f"restored {found.home.domain} in {found.home.path}, {found.entries} log entries")
    say(f"fingerprint {fingerprint(found.home.anchor())}")
    say_what_differs(found)
    if found.home.is_intermediate:  # it signs no lists
        return
    if found.restored_revocations:
        say(f"{found.restored_revocations} revocations newer than the backup were taken over")
    elif newest is not None:
        say("nothing was revoked between the backup and the list")
    if newest is None:
        note(
            "what was revoked after the backup is valid again; if you find a newer list later:"
            " rossec ca refresh --list FILE"
        )
    note("nodes that joined after the backup are not in the record: rossec ca import NODE.pem")
    note("a new revocation list was signed; deliver it with: rossec ca publish")


def say_what_differs(found: "backups.Restored") -> None:
    for name in found.left_out:
        note(f"left out, not a file that a backup has: {printable(name)}")
    if found.policy:
        note(f"the policy is that {found.policy}: read it before it is put in force")
    if found.ended_phones:
        note("no phone can approve any more: register phones again: rossec console phone")
    if found.ended_domains:
        note(f"{found.ended_domains} domains are trusted no more: see rossec domain list --all")


def describe_remaining(remaining: int | None) -> str:
    """Whether the key is held, and for how long (`HeldKey.remaining`), for people."""
    if remaining is None:
        return "locked; unlock it with: rossec ca unlock --for 15m"
    return f"unlocked for {clock.format_duration(remaining)}" if remaining else "unlocked while it runs"


@click.command()
@option(
    "--for seconds",
    "how long the key is held; 0: while the service runs",
    type=UnlockTime(MAX_UNLOCKED),
    default="15m",
    show_default=True,
)
@passphrase.option
@json_result(pass_environment)
def unlock(environment: Environment, seconds: int, passphrase_file: Path | None) -> None:
    """Give the running service the passphrase: it holds the key from now on, for a time.

    Waits some seconds for a service that is starting.
    """
    with closing(_running(environment, wait=_STARTING)) as client:
        secret = passphrase.read(passphrase_file, environment.variables)
        found = client.unlock(secret, seconds)
        say(_describe(found), **found)


def _running(environment: Environment, wait: float = 0) -> KeyServiceClient:
    directory, seconds = AuthorityHome.at(environment.home).path, clock.counter()
    until = seconds() + wait
    while (client := KeyServiceClient.find(directory)) is None:
        if seconds() >= until:
            raise ConfigurationError("the authority's service does not run", _START)
        time.sleep(0.1)
    return client


def _describe(found: dict[str, Value]) -> str:
    remaining = found.get("remaining")
    state = describe_remaining(remaining if isinstance(remaining, int) else None)
    return f"authority of {found.get('domain')!s}: {state}"


@click.command()
@json_result(pass_environment)
def lock(environment: Environment) -> None:
    """Let the running service drop the key at once."""
    with closing(_running(environment)) as client:
        found = client.lock()
        say(_describe(found), **found)


@click.command()
@options.as_json
@pass_environment
def status(environment: Environment, as_json: bool) -> None:
    """Show whether the authority's service runs, and whether it holds the key."""
    client = KeyServiceClient.find(AuthorityHome.at(environment.home).path)
    if client is None:
        text = f"no service runs, each command asks for the passphrase; {_START}"
        say_result(as_json, {"running": False}, [text])
        return
    with closing(client):
        found = client.status()
    say_result(as_json, {"running": True, **found}, [_describe(found)])
