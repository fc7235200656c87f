"""The audit log: denials and administrative actions, one a line, in a hash chain.

A line is a JSON object; its `hash` is SHA-256 over the hash of the line before and the line without it. So a
line cannot be changed, removed or inserted without breaking the chain. Each file begins with a line, signed
with the master's key, that names the hash from which it continues, or none in the very first file: a removed
*beginning*, or a whole file, is detected by it. A removed *end* is detected only by comparison with a later
hash, so `rossec audit --verify` prints the last one. Pure except for `AuditFile`. The rate of lines that
nodes cause is limited before: `rossec.master.operation.admin`.
"""

import hashlib
import json
import logging
import os
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, Final

from cryptography.exceptions import InvalidSignature
from cryptography.hazmat.primitives import hashes
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.hazmat.primitives.asymmetric.utils import encode_dss_signature
from cryptography.hazmat.primitives.serialization import Encoding, PublicFormat

from ca.errors import PathRefused
from ca.keys.signing import Signer, thumbprint
from rossec import files, peer_limits
from rossec.clock import time as host_time
from rossec.errors import ConfigurationError

FIRST: Final = "0" * 64
_KEY, _SIGNATURE = "key", "signature"
_FIRST_FILE: Final = "the audit begins"
_NEXT_FILE: Final = "the audit goes on in a new file"
_COORDINATE: Final = 32
_HINT: Final = (
    "name the parts before it, the oldest first; where they are gone, the last hash that you noted"
    " of them with --after"
)

LEFT_OUT: Final = "left_out"
SYNC_EVERY: Final = 1.0  # seconds
LINE_LIMIT: Final = 8 * 1024
AUDIT: Final = "rossec.audit"
_TAIL: Final = 64 * 1024  # enough to hold the last line
_LATEST: Final = 1 << 40  # seconds since the epoch

Entry = dict[str, Any]
_log = logging.getLogger("rossec.master.audit")


def mark(signer: Signer, before: str, at: float) -> Entry:
    text = _FIRST_FILE if before == FIRST else _NEXT_FILE
    point = signer.public_key.public_bytes(Encoding.X962, PublicFormat.UncompressedPoint)
    entry: Entry = {"at": at, "before": before, "level": "info", "text": text, _KEY: point.hex()}
    return {**entry, _SIGNATURE: signer.sign(_signed(entry)).hex()}


def check_beginning(first: Entry, key: bytes | None = None, after: str | None = None) -> str:
    """Check the beginning of an audit, whose hash was verified; returns a remark, empty when it is complete.
    `key`: thumbprint of the master's key; `after`: the hash of the line before, if they are known."""
    before = first.get("before")
    if _SIGNATURE in first:
        signed_by = _key_of(first)
        if key is not None and signed_by != key:
            raise ConfigurationError(
                f"the audit begins with a line of another key, {signed_by.hex()}",
                "if the master had that key then, name it with --key",
            )
        unknown = "" if key is not None else f"; the key {signed_by.hex()} is not known here"
        complete = before in {FIRST, after}
        return f"{'' if complete else f'it continues from {before}, not among these files'}{unknown}"
    # Not signed: it goes on from the line whose hash was noted.
    if before == after:
        return ""
    if before == FIRST:
        return "its first line is not signed: it is of an older version"
    raise ConfigurationError("the beginning of the audit is missing", _HINT)


def _key_of(entry: Entry) -> bytes:
    try:
        key = ec.EllipticCurvePublicKey.from_encoded_point(ec.SECP256R1(), bytes.fromhex(entry[_KEY]))
        raw = bytes.fromhex(entry[_SIGNATURE])
        r, s = (int.from_bytes(half) for half in (raw[:_COORDINATE], raw[_COORDINATE:]))
        key.verify(encode_dss_signature(r, s), _signed(entry), ec.ECDSA(hashes.SHA256()))
    except (InvalidSignature, ValueError, TypeError, KeyError) as error:
        raise ConfigurationError("the first line of the audit is forged", _HINT) from error
    return thumbprint(key)


def _signed(entry: Entry) -> bytes:
    return "\n".join(
        ("rossec audit, a file begins", str(entry["before"]), str(entry["at"]), str(entry["text"]))
    ).encode()


def with_hash(entry: Entry, before: str) -> Entry:
    text = json.dumps(entry, sort_keys=True, separators=(",", ":"))
    data = f"{before}\n{text}".encode(errors="surrogatepass")  # a foreign line may contain surrogates
    return {**entry, "hash": hashlib.sha256(data).hexdigest()}


def encode(entry: Entry) -> str:
    return json.dumps(entry, sort_keys=True, separators=(",", ":"))


def read_entries(lines: Iterable[str], max_damaged: int | None = None) -> tuple[list[Entry], list[int]]:
    """The valid entries, and the numbers of the damaged lines; reading ends after `max_damaged` of those."""
    entries, damaged = list[Entry](), list[int]()
    for number, line in enumerate(lines, 1):
        entry = _entry(line)
        if entry is not None:
            entries.append(entry)
            continue
        damaged.append(number)
        if len(damaged) == max_damaged:
            break
    return entries, damaged


def _entry(line: str) -> Entry | None:
    try:
        entry = json.loads(line) if len(line) <= LINE_LIMIT else None
    except (ValueError, RecursionError):
        return None
    match entry:
        case {"hash": str(), "text": str(), "level": str(), "at": int() | float() as at}:
            return entry if 0 <= at < _LATEST else None
        case _:
            return None


def verify(entries: Iterable[Entry], before: str | None = None) -> str:
    last = before
    for number, entry in enumerate(entries, 1):
        rest = {key: value for key, value in entry.items() if key != "hash"}
        # The link is part of what was hashed: a line removed, inserted or moved breaks the next one.
        link = rest.get("before")
        if not isinstance(link, str) or (last is not None and link != last):
            raise ConfigurationError(f"before line {number} of the audit something is missing")
        if with_hash(rest, link) != entry:
            raise ConfigurationError(f"line {number} of the audit was changed")
        last = entry["hash"]
    return FIRST if last is None else last


class AuditFile(logging.Handler):
    """Appends what is logged to `rossec.audit` to a file of its owner alone (0600); `signer`: the master.

    Each line is written at once and synced within a second of the first line not yet synced. When the file is
    moved away (logrotate), the next line begins a new file, and the chain continues. A line that was
    truncated (full disk, power failure) is removed, and the next one records that.
    """

    def __init__(
        self, path: Path, clock: Callable[[], float] = host_time, signer: Signer | None = None
    ) -> None:
        super().__init__(logging.INFO)
        self._signer = signer
        self._path = path
        self._clock = clock
        self._file = files.append_own(path)
        size = os.fstat(self._file).st_size
        tail = os.pread(self._file, _TAIL, max(0, size - _TAIL))
        self._torn = len(tail) - (tail.rfind(b"\n") + 1)
        if self._torn:
            os.ftruncate(self._file, size - self._torn)
        lines = tail[: len(tail) - self._torn].decode(errors="replace").splitlines()
        entries, _ = read_entries(lines)  # the first may be incomplete
        self._last: str = entries[-1]["hash"] if entries else FIRST
        self._synced = clock()
        self.is_failing = False  # the last line could not be written

    def emit(self, record: logging.LogRecord) -> None:
        now = self._clock()
        entry: Entry = {
            "at": round(now, 3),
            "level": record.levelname.lower(),
            "text": peer_limits.printable(record.getMessage(), LINE_LIMIT // 8),
        }
        if left_out := getattr(record, LEFT_OUT, 0):
            entry[LEFT_OUT] = left_out
        if self._torn:
            entry["cut_short"] = self._torn
        try:
            try:
                there = self._path.stat()
            except FileNotFoundError:
                there = None
            here = os.fstat(self._file)
            if there is None or (there.st_dev, there.st_ino) != (here.st_dev, here.st_ino):
                # Open first: the number of a closed descriptor may be reused.
                self._file, old = files.append_own(self._path), self._file
                os.close(old)
            at = round(now, 3)
            if self._signer is not None and os.fstat(self._file).st_size == 0:
                self._append(with_hash(mark(self._signer, self._last, at), self._last))
            self._append(with_hash({**entry, "before": self._last}, self._last))
            self._torn, self.is_failing = 0, False
        except (OSError, PathRefused) as error:
            # A full disk must not end the master; a line for every denial would fill the log instead.
            if not self.is_failing:
                _log.error("the audit cannot be written: %s; the lines before are intact", error)
            self.is_failing = True
        if now - self._synced >= SYNC_EVERY or now < self._synced:
            self.sync()

    def sync(self) -> None:
        self._synced = self._clock()
        with suppress(OSError):
            os.fdatasync(self._file)

    def close(self) -> None:
        if self._file >= 0:
            self.sync()
            os.close(self._file)
            self._file = -1
        super().close()

    def _append(self, entry: Entry) -> None:
        line = f"{encode(entry)}\n".encode()
        size = os.fstat(self._file).st_size
        if os.write(self._file, line) != len(line):
            os.ftruncate(self._file, size)  # half a line would stay damaged
            raise OSError("the disk is full")
        self._last = entry["hash"]


@contextmanager
def audit_written(path: Path, signer: Signer) -> Iterator[AuditFile]:
    handler = AuditFile(path, signer=signer)
    log, root = logging.getLogger(AUDIT), logging.getLogger()
    level = log.level
    log.setLevel(logging.INFO)
    for other in root.handlers:  # the other handlers write no more than without an audit
        other.setLevel(max(other.level, root.level))
    log.addHandler(handler)
    try:
        yield handler
    finally:
        log.setLevel(level)
        log.removeHandler(handler)
        handler.close()
