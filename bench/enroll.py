"""What issuing an identity costs beside the bare signature, and what the log costs per entry.

`openssl ca` signs and appends a line to a text file; here are the same two parts: one P-256
signature (`raw sign`), and everything between a request and a recorded, durable certificate. The
parts are measured interleaved, round by round, and the medians compared.
"""

import secrets
import statistics
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

from ca.authority import Authority, create_root
from ca.keys.private_keys import generate
from ca.keys.signing import KeySigner
from ca.revocation import merkle
from ca.revocation.merkle import Tree
from ca.store.record import Store
from ca.store.values import digest_of
from ca.svid import build_request
from rossec.authority.signing import SigningAuthority

NOW = 1_800_000_000
SIZES = (100, 10_000)
BATCH = 10


class BenchAuthority:
    """An authority with a record on the disk, and requests that wait."""

    def __init__(self, directory: Path) -> None:
        self.signer = KeySigner(generate())
        root = create_root(self.signer, "home", now=NOW, serial=1)
        self.authority = Authority(self.signer, root)
        self.store = Store.create(directory / "ca.db")
        self.open = SigningAuthority(self.authority, self.store, directory)
        self.open.sign_list(NOW)
        self.node = KeySigner(generate())
        self.count = 0

    def request(self) -> bytes:
        """A request for a new name."""
        self.count += 1
        return build_request(self.node, "home", f"/robot{self.count}")

    def fill(self, entries: int) -> None:
        """Let the log grow to `entries`."""
        while self.store.log.head(NOW).size < entries:
            self.store.log_event("bench", "filler", "", NOW)


def timed(action: Callable[[], object]) -> float:
    """Seconds for one call."""
    start = time.perf_counter()
    action()
    return time.perf_counter() - start


def rounds(authority: BenchAuthority, seconds: float) -> dict[str, list[float]]:
    """Each part in turn, until the time is over."""
    taken: dict[str, list[float]] = {name: [] for name in ("raw", "certificate", "issue", "log")}
    end = time.perf_counter() + seconds
    while time.perf_counter() < end:
        for _ in range(BATCH):
            request = authority.request()
            serial = secrets.randbits(127) + 1
            taken["raw"].append(timed(lambda: authority.signer.sign(request)))  # noqa: B023
            taken["certificate"].append(
                timed(lambda: authority.authority.issue(request, now=NOW, serial=serial))  # noqa: B023
            )
            taken["issue"].append(timed(lambda: authority.open.issue(request, NOW)))  # noqa: B023
            taken["log"].append(timed(lambda: authority.store.log_event("bench", "/a", "entry", NOW)))
    return taken


def log_hashing(entries: int) -> float:
    """Microseconds for the hashes of one more entry in a log of `entries`, without the disk."""
    tree = Tree(str(number).encode() for number in range(entries))
    peaks: tuple[bytes, ...] = ()
    for number in range(entries):
        peaks = merkle.extend(peaks, number, str(number).encode())
    assert merkle.root_of(peaks) == tree.root()
    row = (entries, "/a", b"k" * 32)
    each = [timed(lambda: merkle.extend(peaks, entries, digest_of(row))) for _ in range(500)]
    return statistics.median(each) * 1e6


def audit_ms(authority: BenchAuthority) -> float:
    """Milliseconds for the whole verification of the log and the record."""
    return timed(lambda: authority.store.log.audit(authority.signer.public_key)) * 1e3


def measure(seconds: float) -> dict[str, object]:
    """Issuance against a raw signature, at two sizes of the record, in about `seconds`."""
    result: dict[str, object] = {}
    with tempfile.TemporaryDirectory() as directory:
        authority = BenchAuthority(Path(directory))
        for size in SIZES:
            authority.fill(size)
            taken = rounds(authority, seconds / len(SIZES))
            medians = {name: statistics.median(values) for name, values in taken.items()}
            result[f"log of {size}"] = {
                "raw_signs_per_s": round(1 / medians["raw"]),
                "certificates_per_s": round(1 / medians["certificate"]),
                "issued_per_s": round(1 / medians["issue"]),
                "issue_ms": round(medians["issue"] * 1e3, 3),
                "issue_to_raw_sign": round(medians["issue"] / medians["raw"], 1),
                "log_entry_ms": round(medians["log"] * 1e3, 3),
                "log_entry_hashing_us": round(log_hashing(size), 1),
                "entries": authority.store.log.head(NOW).size,
                "audit_ms": round(audit_ms(authority), 1),
            }
        authority.store.close()
    return result
