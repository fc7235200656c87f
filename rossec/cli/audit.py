"""`rossec audit`: what the master denied, and what was administered."""

from pathlib import Path

import click

from ca.keys.signing import thumbprint
from rossec.cli.shared.context import Environment, pass_environment
from rossec.cli.shared.options import NEW_FILE, flag, option
from rossec.clock import format_time
from rossec.environment import own_master
from rossec.errors import ConfigurationError
from rossec.files import lines, open_text
from rossec.home import NodeHome
from rossec.host import audit as audits
from rossec.terminal import note, printable, say

AUDIT = "audit.log"
_MOST_DAMAGED = 10_000  # lines; a file with more is not an audit
_MOST_SHOWN = 20
_NOTES = {"left_out": "lines like it before it were left out", "cut_short": "bytes before it were cut short"}


@click.command()
@flag("--json as_json", "the lines as they are")
@option("--since", "seconds since the epoch", type=click.IntRange(0))
@flag("--verify verified", "check that nothing was changed")
@option("--after=HASH", "the last hash of the parts before, which are gone")
@option("--key=HEX", "thumbprint of the key the master had then")
@flag("--ca of_authority", "the audit of `rossec ca serve` instead")
@click.argument("files", nargs=-1, type=NEW_FILE)
@pass_environment
def audit(
    environment: Environment,
    as_json: bool,
    since: int | None,
    verified: bool,
    after: str | None,
    key: str | None,
    of_authority: bool,
    files: tuple[Path, ...],
) -> None:
    """Show the master's audit: what was denied, and what was administered.

    With --ca: what the authority's service signed, and for whom. FILES are the audit in the order
    of its parts, by default the one that is written now.
    """
    if of_authority:
        from rossec.authority.home import AUDIT_FILE, AuthorityHome  # noqa: PLC0415 - not for a master

        authority = AuthorityHome.at(environment.home)
        writer, usual = authority.node(), authority.path / AUDIT_FILE
    else:
        writer = NodeHome.of(environment.home, own_master(environment.variables))
        usual = writer.path / AUDIT
    entries: list[audits.Entry] = []
    for path in files or (usual,):
        missing = ConfigurationError(f"there is no {path}", "has the master run here? with --ca: the service")
        with open_text(path, missing) as file:
            most = 1 if verified else _MOST_DAMAGED
            found, damaged = audits.read_entries(lines(file, audits.LINE_LIMIT + 2), most)
        if damaged and verified:
            raise ConfigurationError(f"line {damaged[0]} of {path} is damaged", "compare a backup")
        _note_damage(path, damaged)
        entries += found
    # Each part begins with a signed line that names the hash before it (attack `cut-audit`).
    last = audits.verify(entries, after) if verified else ""
    if verified and entries:
        known = _key(writer, key)
        if remark := audits.check_beginning(entries[0], known, after):
            note(remark)
    for entry in entries:
        if since is None or entry["at"] >= since:
            more = "".join(f" ({entry[key]} {text})" for key, text in _NOTES.items() if key in entry)
            line = printable(f"{format_time(int(entry['at']))}  {entry['text']}{more}")
            say(audits.encode(entry) if as_json else line)
    if verified:
        # A removed end is found only by comparing the last hash with one that was noted.
        note(f"nothing was changed in {len(entries)} lines; the last is {last}")


def _key(home: NodeHome, given: str | None) -> bytes | None:
    if given is None:
        return thumbprint(home.signer().public_key) if (home.path / "node.key").exists() else None
    try:
        return bytes.fromhex(given)
    except ValueError:
        raise ConfigurationError(f"{given!a} is not a thumbprint", "64 hexadecimal digits") from None


def _note_damage(path: Path, damaged: list[int]) -> None:
    if len(damaged) == _MOST_DAMAGED:
        raise ConfigurationError(
            f"{len(damaged)} of the first {damaged[-1]} lines of {path} are damaged",
            "is it the right file? if so, compare a backup",
        )
    for number in damaged[:_MOST_SHOWN]:
        note(f"line {number} of {path} is damaged and not shown")
    if more := len(damaged[_MOST_SHOWN:]):
        note(f"{more} more lines of {path} are damaged and not shown")
