"""Records every packet on loopback while a command runs, in a network namespace of its own.

As a program (`python -m tests.support.recorder FILE MARKER COMMAND...`) it records; the
rest of the module starts that and reads the file. The namespace excludes the traffic of other
programs; without one, the host's own loopback is recorded.
"""

import json
import os
import socket
import struct
import subprocess
import sys
import threading
from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass
from fcntl import ioctl
from functools import cached_property
from pathlib import Path
from typing import Final

import pytest

Flow = tuple[bytes, int, bytes, int]  # source and destination, address and port
_ETH_P_ALL, _OUTGOING = 0x0003, 4  # loopback shows each packet twice: leaving and arriving
_SOL_PACKET, _STATISTICS = 263, 6
_GET_FLAGS, _SET_FLAGS, _UP = 0x8913, 0x8914, 1
_BUFFER: Final = 256 * 1024 * 1024
_ISOLATION: Final = (("unshare", "--net"), ("unshare", "--map-root-user", "--net"), ())


@dataclass(frozen=True)
class Recording:
    """The packets seen on loopback."""

    packets: list[bytes]
    dropped: int

    @cached_property
    def flows(self) -> dict[Flow, bytes]:
        """The TCP payload of each direction of each connection, in order, once."""
        segments: dict[Flow, dict[int, bytes]] = defaultdict(dict)
        for packet in self.packets:
            if (segment := _tcp(packet)) is not None:
                flow, number, payload = segment
                if len(payload) > len(segments[flow].get(number, b"")):
                    segments[flow][number] = payload
        return {flow: _joined(parts) for flow, parts in segments.items() if parts}

    def holds(self, secret: bytes) -> bool:
        """Whether `secret` went over loopback in clear, also across packets."""
        return any(secret in data for data in (*self.packets, *self.flows.values()))


def _tcp(packet: bytes) -> tuple[Flow, int, bytes] | None:
    """Flow, sequence number and payload of an Ethernet frame with TCP over IPv4 or IPv6."""
    ip = packet[14:]
    match packet[12:14]:
        case b"\x08\x00" if ip[9] == 6:
            start, source, target = 4 * (ip[0] & 15), ip[12:16], ip[16:20]
            end = int.from_bytes(ip[2:4]) or len(ip)
        case b"\x86\xdd" if ip[6] == 6:
            start, source, target, end = 40, ip[8:24], ip[24:40], len(ip)
        case _:
            return None
    tcp = ip[start:end]
    sport, dport, number = struct.unpack_from("!HHI", tcp)
    flow = source, sport, target, dport
    return flow, number + (tcp[13] >> 1 & 1), tcp[4 * (tcp[12] >> 4) :]  # a SYN counts as one


def _joined(parts: dict[int, bytes]) -> bytes:
    first = min(parts)  # test flows are short: sequence numbers that wrap are not expected twice
    if max(parts) - first > 1 << 31:
        parts = {(number + (1 << 31)) % (1 << 32): part for number, part in parts.items()}
        first = min(parts)
    data = bytearray()
    for number in sorted(parts):
        data[number - first :] = parts[number] + data[number - first + len(parts[number]) :]
    return bytes(data)


def record(
    file: Path, marker: bytes, command: Sequence[str], env: dict[str, str]
) -> tuple[Recording, subprocess.CompletedProcess[str]]:
    """Run `command` under the recorder; skips the test where packets cannot be recorded."""
    errors = ""
    for isolation in _ISOLATION:
        own = [sys.executable, "-m", "tests.support.recorder", str(file), marker.decode()]
        done = subprocess.run(
            [*isolation, *own, *command], env=env, text=True, capture_output=True, timeout=90, check=False
        )
        if file.exists():
            return _load(file), done
        errors += done.stderr
    if os.environ.get("CI"):
        pytest.fail(f"packets on loopback cannot be recorded here: {errors}")
    pytest.skip("NOT RUN: recording loopback needs CAP_NET_RAW or user namespaces")


def _load(file: Path) -> Recording:
    data = file.read_bytes()
    (length,) = struct.unpack_from("!I", data)
    about = json.loads(data[4 : 4 + length])
    packets, position = [], 4 + length
    for size in about["sizes"]:
        packets.append(data[position : position + size])
        position += size
    return Recording(packets, about["dropped"])


def main(file: Path, marker: bytes, command: Sequence[str]) -> int:
    """Record while `command` runs; before and after it `marker` is sent, as a control."""
    _bring_up_loopback()
    with socket.socket(socket.AF_PACKET, socket.SOCK_RAW, socket.htons(_ETH_P_ALL)) as raw:
        _enlarge(raw)
        raw.bind(("lo", 0))
        raw.settimeout(0.2)
        packets: list[bytes] = []
        stop = threading.Event()
        reader = threading.Thread(target=_read, args=(raw, packets, stop))
        reader.start()
        try:
            send_in_two(marker)
            code = subprocess.run(command, check=False).returncode
            send_in_two(marker)
        finally:
            stop.set()
            reader.join()
        _, dropped = struct.unpack("II", raw.getsockopt(_SOL_PACKET, _STATISTICS, 8))
    about = json.dumps({"sizes": list(map(len, packets)), "dropped": dropped}).encode()
    file.write_bytes(struct.pack("!I", len(about)) + about + b"".join(packets))
    return code


def _read(raw: socket.socket, packets: list[bytes], stop: threading.Event) -> None:
    """Read until notified to stop, then until no packet is left."""
    while True:
        try:
            packet, (_, _, kind, *_) = raw.recvfrom(1 << 20)
        except TimeoutError:
            if stop.is_set():
                return
        else:
            if kind == _OUTGOING:
                packets.append(packet)


def _bring_up_loopback() -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as any_socket:
        request = struct.pack("16sH14x", b"lo", 0)
        (flags,) = struct.unpack_from("16xH", ioctl(any_socket, _GET_FLAGS, request))
        if not flags & _UP:
            ioctl(any_socket, _SET_FLAGS, struct.pack("16sH14x", b"lo", flags | _UP))


def _enlarge(raw: socket.socket) -> None:
    try:
        raw.setsockopt(socket.SOL_SOCKET, 33, _BUFFER)  # SO_RCVBUFFORCE
    except PermissionError:
        raw.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, _BUFFER)


def send_in_two(marker: bytes) -> None:
    """Send `marker` over loopback TCP so that no single packet holds all of it."""
    half = len(marker) // 2
    with (
        socket.create_server(("127.0.0.1", 0)) as server,
        socket.create_connection(server.getsockname()) as near,
        server.accept()[0] as far,
    ):
        near.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        near.sendall(marker[:half])
        received = far.recv(len(marker))
        near.sendall(marker[half:])
        while len(received) < len(marker):
            received += far.recv(len(marker))


if __name__ == "__main__":
    sys.exit(main(Path(sys.argv[1]), sys.argv[2].encode(), sys.argv[3:]))
