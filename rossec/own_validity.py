"""What a node says when its own identity is over: that it ended, or that the clock is in doubt.

A shell: what was signed, and the times of the files, show how late it is at least. A host whose
clock is years ahead has nothing of that time; neither has one that was off for as long, so that
both are told.
"""

from collections.abc import Iterable
from contextlib import suppress
from pathlib import Path
from typing import Final

from ca import svid
from ca.certificates import TrustAnchor
from ca.errors import CertificateExpired, RevocationRefused
from ca.revocation.state import open_statement
from ca.validity import everything_ended, own_end

_FILES: Final = ("node.pem", "ca.pem", "revocations.cose", "grants")


def ended(
    name: str, chain: Iterable[bytes], anchor: TrustAnchor, now: int, seen: int
) -> CertificateExpired:
    """The refusal of the own identity `name`, whose `chain` is not valid any more at `now`.

    `seen`: how late it is at least, as far as is known without the clock.
    """
    if now > anchor.not_after:
        return everything_ended(anchor.domain, anchor.not_after, now)
    end = min(svid.validity(svid.parse(der))[1] for der in chain)
    return own_end(name, end, now, seen)


def seen_in(directory: Path, anchor: TrustAnchor, revocations: bytes | None) -> int:
    """How late it is at least: by the files of a node, and by the list that it holds."""
    times = [anchor.not_before]
    for name in _FILES:
        path = directory / name
        if path.exists():
            times.append(int(path.stat().st_mtime))
    if revocations is not None:
        with suppress(RevocationRefused):  # of another authority
            times.append(open_statement(revocations, anchor.public_key).issued)
    return max(times)


def has_key(name: str, directory: Path) -> str:
    """What somebody does who asks for the key of a node anew, which is in `directory`."""
    anew = "for a new key, without the grants of this one, move that directory away first"
    if (directory / "node.pem").exists():
        renew = f"rossec ca renew --expired {name}, then here: rossec node install FILE"
        return f"if its identity is over, where the authority is: {renew}; {anew}"
    return f"its request is {directory / 'node.csr'}; {anew}"
