"""Plain TCP, TLS 1.3 (mutual, P-256) and rossec, side by side through the real asyncio drivers.

Two processes on loopback, the variants in turn within every round; a ratio is the median of the
rounds' ratios, so a disturbance hits both sides of it. `throughput` is a loop of sends, and rossec
joins what one turn of the loop sends: part of what is measured. `paced` gives the loop a turn after
every message, so that nothing can be joined. Both close their connections in order.
"""

import asyncio
import datetime
import multiprocessing
import secrets
import ssl
import tempfile
import time
from collections import defaultdict
from collections.abc import Awaitable, Callable
from contextlib import suppress
from multiprocessing.queues import Queue
from pathlib import Path
from statistics import median
from typing import Any, TypeAlias

from cryptography import x509
from cryptography.hazmat.primitives import hashes, serialization
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.x509.oid import NameOID

from ca.signer import KeySigner
from rossec.channel.connection import Connection
from rossec.channel.credentials import Credentials
from rossec.channel.known import KnownCertificates
from rossec.channel.suites import HYBRID, POST_QUANTUM
from rossec.errors import ChannelError
from rossec.net.stream import SecureStream, connect, serve

SIZES = (64, 1024, 16 * 1024, 256 * 1024, 1024 * 1024, 6 * 1024 * 1024)
VOLUME = {64: 512 * 1024, 1024: 4 << 20}  # bytes per sample; the others below
LARGE_VOLUME = 32 << 20
_ECDSA = ec.ECDSA(hashes.SHA256())

Samples: TypeAlias = dict[tuple[str, str], list[float]]


class Site:
    """One authority and one certificate, shared by both variants: P-256 throughout."""

    def __init__(self, folder: Path) -> None:
        self.root_key = ec.generate_private_key(ec.SECP256R1())
        self.key = ec.generate_private_key(ec.SECP256R1())
        self.other_key = ec.generate_private_key(ec.SECP256R1())
        self.root = _certificate("root", self.root_key.public_key(), self.root_key, ca=True)
        self.server = _certificate("server", self.key.public_key(), self.root_key, ca=False)
        self.client = _certificate("client", self.other_key.public_key(), self.root_key, ca=False)
        self._write(folder, "server", self.key, self.server)
        self._write(folder, "client", self.other_key, self.client)
        (folder / "root.pem").write_bytes(self.root.public_bytes(serialization.Encoding.PEM))

    @staticmethod
    def _write(
        folder: Path, name: str, key: ec.EllipticCurvePrivateKey, certificate: x509.Certificate
    ) -> None:
        private = key.private_bytes(
            serialization.Encoding.PEM,
            serialization.PrivateFormat.PKCS8,
            serialization.NoEncryption(),
        )
        public = certificate.public_bytes(serialization.Encoding.PEM)
        (folder / f"{name}.pem").write_bytes(private + public)


class Peer:
    """The least identity the channel needs."""

    def __init__(self, certificate: x509.Certificate) -> None:
        key = certificate.public_key()
        assert isinstance(key, ec.EllipticCurvePublicKey)
        self.public_key = key
        self.not_after = int(certificate.not_valid_after_utc.timestamp())


def _certificate(
    name: str, key: ec.EllipticCurvePublicKey, issuer: ec.EllipticCurvePrivateKey, *, ca: bool
) -> x509.Certificate:
    now = datetime.datetime.now(datetime.UTC)  # noqa: TID251 - a bench is a shell
    subject = x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, name)])
    root = x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, "root")])
    uri = x509.UniformResourceIdentifier(f"spiffe://home/robot1/{name}")
    builder = (
        x509.CertificateBuilder()
        .subject_name(subject)
        .issuer_name(root)
        .public_key(key)
        .serial_number(x509.random_serial_number())
        .not_valid_before(now - datetime.timedelta(hours=1))
        .not_valid_after(now + datetime.timedelta(days=30))
        .add_extension(x509.BasicConstraints(ca=ca, path_length=None), critical=True)
        .add_extension(x509.SubjectAlternativeName([uri]), critical=False)
    )
    return builder.sign(issuer, hashes.SHA256())


def verifier(folder: Path) -> Callable[[tuple[bytes, ...], int], Peer]:
    """Parse and verify each time, as TLS does."""
    root = x509.load_pem_x509_certificate((folder / "root.pem").read_bytes())
    key, name = root.public_key(), root.subject
    assert isinstance(key, ec.EllipticCurvePublicKey)

    def verify(chain: tuple[bytes, ...], now: int) -> Peer:
        certificate = x509.load_der_x509_certificate(chain[0])
        peer = Peer(certificate)
        assert certificate.issuer == name
        assert now < peer.not_after
        # As `ca.certificates` does it: the authority's key is parsed once.
        key.verify(certificate.signature, certificate.tbs_certificate_bytes, _ECDSA)
        return peer

    return verify


def credentials(folder: Path, name: str) -> Credentials:
    """Load what `Site` wrote."""
    pem = (folder / f"{name}.pem").read_bytes()
    key = serialization.load_pem_private_key(pem, None)
    assert isinstance(key, ec.EllipticCurvePrivateKey)
    certificate = x509.load_pem_x509_certificate(pem)
    der = certificate.public_bytes(serialization.Encoding.DER)
    return Credentials(KeySigner(key), (der,))


def tls(folder: Path, name: str, *, server: bool) -> ssl.SSLContext:
    """TLS 1.3, both sides with certificates, no session tickets."""
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER if server else ssl.PROTOCOL_TLS_CLIENT)
    context.minimum_version = ssl.TLSVersion.TLSv1_3
    context.check_hostname = False
    context.verify_mode = ssl.CERT_REQUIRED
    context.load_cert_chain(folder / f"{name}.pem")
    context.load_verify_locations(folder / "root.pem")
    if server:
        context.num_tickets = 0
    return context


class Pipe:
    """The same few verbs over a `SecureStream` or over asyncio's streams."""

    def __init__(self, stream: SecureStream[Peer] | None, plain: Any = None) -> None:
        self._secure = stream
        self._plain = plain

    async def send(self, data: bytes) -> None:
        if self._secure is not None:
            await self._secure.send(data)
        else:
            self._plain[1].write(data)
            await self._plain[1].drain()

    async def receive(self) -> bytes:
        if self._secure is not None:
            return await self._secure.receive()
        data: bytes = await self._plain[0].read(1 << 20)
        if not data:
            raise EOFError
        return data

    async def close(self) -> None:
        if self._secure is not None:
            await self._secure.close()
        else:
            self._plain[1].close()  # over TLS this is close_notify, both ways
            with suppress(OSError):
                await self._plain[1].wait_closed()


async def sink(pipe: Pipe) -> None:
    """`count` in 8 bytes, then so many bytes, then answer one byte; for ever."""
    pending = b""
    try:
        while True:
            while len(pending) < 8:
                pending += await pipe.receive()
            left = int.from_bytes(pending[:8]) - len(pending) + 8
            while left > 0:
                left -= len(await pipe.receive())
            pending = b""
            await pipe.send(b"k")
    except (EOFError, ChannelError, OSError):
        await pipe.close()


def _server_process(folder: Path, ports: "Queue[tuple[int, int, int]]") -> None:
    async def main() -> None:
        async def plain(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
            await sink(Pipe(None, (reader, writer)))

        async def secure(stream: SecureStream[Peer]) -> None:
            await sink(Pipe(stream))

        context = tls(folder, "server", server=True)
        limit = 2 << 20
        a = await asyncio.start_server(plain, "127.0.0.1", 0, limit=limit)
        b = await asyncio.start_server(plain, "127.0.0.1", 0, limit=limit, ssl=context)
        c = await serve(
            secure,
            "127.0.0.1",
            0,
            credentials(folder, "server"),
            verifier(folder),
            suites=POST_QUANTUM["prefer"],
            known=KnownCertificates(),
        )
        ports.put((*(s.sockets[0].getsockname()[1] for s in (a, b)), c.port))
        await asyncio.Event().wait()

    asyncio.run(main())


async def throughput(pipe: Pipe, size: int, *, paced: bool = False) -> float:
    """Seconds per message."""
    count = max(3, VOLUME.get(size, LARGE_VOLUME) // size)
    data = bytes(size)
    start = time.perf_counter()
    await pipe.send((size * count).to_bytes(8))
    for _ in range(count):
        await pipe.send(data)
        if paced:
            await asyncio.sleep(0)
    await pipe.receive()
    return (time.perf_counter() - start) / count


async def latency(pipe: Pipe) -> float:
    """Seconds one way for 64 bytes."""
    start = time.perf_counter()
    for _ in range(200):
        await pipe.send((56).to_bytes(8) + bytes(56))
        await pipe.receive()
    return (time.perf_counter() - start) / 400


async def handshakes(make: Callable[[], Awaitable[Pipe]]) -> float:
    """Seconds per connection with one message there and back."""
    start = time.perf_counter()
    for _ in range(20):
        pipe = await make()
        await pipe.send((56).to_bytes(8) + bytes(56))
        await pipe.receive()
        await pipe.close()
    return (time.perf_counter() - start) / 20


async def _measure(folder: Path, ports: tuple[int, int, int], seconds: float) -> dict[str, object]:
    context = tls(folder, "client", server=False)
    own, verify = credentials(folder, "client"), verifier(folder)

    async def plain() -> Pipe:
        return Pipe(None, await asyncio.open_connection("127.0.0.1", ports[0], limit=2 << 20))

    async def secured() -> Pipe:
        opened = await asyncio.open_connection(
            "127.0.0.1", ports[1], limit=2 << 20, ssl=context, server_hostname=""
        )
        return Pipe(None, opened)

    async def rossec() -> Pipe:
        return Pipe(await connect("127.0.0.1", ports[2], own, verify))

    async def hybrid() -> Pipe:
        suites = POST_QUANTUM["require"]
        return Pipe(await connect("127.0.0.1", ports[2], own, verify, suites=suites))

    known = KnownCertificates()

    async def brief() -> Pipe:
        return Pipe(await connect("127.0.0.1", ports[2], own, verify, known=known))

    makers: dict[str, Callable[[], Awaitable[Pipe]]] = {
        "plain": plain,
        "tls": secured,
        "rossec": rossec,
    }
    samples: Samples = defaultdict(list)
    end = time.monotonic() + seconds
    pipes = {name: await make() for name, make in makers.items()}
    while True:
        await _throughput_round(pipes, samples)
        for name, make in makers.items():
            samples[name, "latency"].append(await latency(pipes[name]))
            samples[name, "handshake"].append(await handshakes(make))
        samples["rossec", "handshake hybrid"].append(await handshakes(hybrid))
        samples["rossec", "handshake x5t"].append(await handshakes(brief))
        if time.monotonic() >= end:
            break
    for pipe in pipes.values():
        await pipe.close()
    return _report(samples, _handshake_bytes(folder))


async def _throughput_round(pipes: dict[str, Pipe], samples: Samples) -> None:
    for size in SIZES:
        for name, pipe in pipes.items():
            samples[name, str(size)].append(await throughput(pipe, size))
    for size in SIZES[:2]:
        for name, pipe in pipes.items():
            samples[name, f"{size} paced"].append(await throughput(pipe, size, paced=True))


def _handshake_bytes(folder: Path) -> dict[str, int]:
    """What both sides send until the connection is open, openings and frames included."""
    memories = KnownCertificates(), KnownCertificates()
    return {
        "handshake_bytes_x5chain": _one_handshake(folder, *memories, (6,), brief=False),
        "handshake_bytes_x5t": _one_handshake(folder, *memories, (6,), brief=True),
        "handshake_bytes_hybrid": _one_handshake(folder, None, None, (HYBRID,), brief=False),
    }


def _one_handshake(
    folder: Path,
    ours: KnownCertificates | None,
    theirs: KnownCertificates | None,
    suites: tuple[int, ...],
    *,
    brief: bool,
) -> int:
    verify, now, random = verifier(folder), int(time.time()), secrets.token_bytes
    client, server = credentials(folder, "client"), credentials(folder, "server")
    left = Connection[Peer].initiator(
        client, verify, random=random, now=now, suites=suites, known=ours, brief=brief
    )
    right = Connection[Peer].responder(
        server, verify, random=random, now=now, suites=suites, known=theirs
    )
    total = 0
    for _ in range(2):
        for sender, receiver in ((left, right), (right, left)):
            data = sender.data_to_send()
            total += len(data)
            receiver.receive_data(data, now)
    return total


def _report(samples: Samples, sizes_on_the_wire: dict[str, int]) -> dict[str, object]:
    def ratio(other: str, what: str, ours: str = "") -> float:
        pairs = zip(samples[other, what], samples["rossec", ours or what], strict=True)
        return round(median(a / b for a, b in pairs), 2)

    sizes = [str(size) for size in SIZES]
    return {
        "throughput_vs_tls": {size: ratio("tls", size) for size in sizes},
        "throughput_vs_plain": {size: ratio("plain", size) for size in sizes},
        "paced_vs_tls": {size: ratio("tls", f"{size} paced") for size in sizes[:2]},
        "latency_vs_tls": ratio("tls", "latency"),
        "handshake_rate_vs_tls": ratio("tls", "handshake"),
        "handshake_rate_vs_tls_hybrid": ratio("tls", "handshake", "handshake hybrid"),
        "handshake_rate_vs_tls_x5t": ratio("tls", "handshake", "handshake x5t"),
        **sizes_on_the_wire,
        "rounds": len(samples["rossec", "latency"]),
        "median_microseconds": {
            name: {
                what: round(median(values) * 1e6, 2)
                for (there, what), values in samples.items()
                if there == name
            }
            for name in ("plain", "tls", "rossec")
        },
    }


def measure(seconds: float) -> dict[str, object]:
    """Measure for about `seconds`; at least one full round."""
    context = multiprocessing.get_context("spawn")
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        Site(folder)
        ports: Queue[tuple[int, int, int]] = context.Queue()
        process = context.Process(target=_server_process, args=(folder, ports), daemon=True)
        process.start()
        try:
            return asyncio.run(_measure(folder, ports.get(timeout=30), seconds))
        finally:
            process.terminate()
            process.join()
