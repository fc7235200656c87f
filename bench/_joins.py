"""Nodes that join a running `rossec ca serve`: from the first octet to the verified identity.

The service (it holds the key) and its network face are processes of their own; the nodes' side of
all joins is this process, and so takes a part of the two processors. Keys and CSRs are made before
the clock starts; nothing is written on the nodes' side. Every identity is in the record, durably,
when its node has it. With a policy, a round lasts until each node's grants are signed too.
"""

import asyncio
import contextlib
import statistics
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

from bench._applied import SilentMaster, enroll
from bench._masters import Master, free_port, running
from ca.enrollment.invitation import InvitationCode
from ca.keys.private_keys import generate
from ca.keys.signing import KeySigner
from ca.svid import build_request
from rossec import clock
from rossec.authority.invitations import invite
from rossec.authority.policyfile import NAME, read_policy
from rossec.authority.service import AuthorityService
from rossec.enrollment.join import join
from tests.support.commands import PASSPHRASE
from tests.support.serviceprocess import ServiceProcess, children_of

ROUNDS = 5
NODES = 60  # of a round
AT_ONCE = 8
IDENTITIES = 3000  # in the record before, where there is a policy
_SITES = 16
_LASTS = 3600
_PATIENCE = 120.0


class Round(NamedTuple):
    """Joins a second, and milliseconds of processor time for one in each process."""

    joins_per_s: float
    service_ms: float
    face_ms: float


class Authority:
    """A running service, and the nodes that join it."""

    def __init__(self, process: ServiceProcess, port: int) -> None:
        self._process = process
        self._address = f"127.0.0.1:{port}"
        (face,) = children_of(process.pid)
        self._service, self._face = Master(process.pid, port), Master(face, port)
        self._count = 0

    def round(self, nodes: int, *, granted: bool) -> Round:
        """Let `nodes` new nodes join, `AT_ONCE` at a time; `granted`: until they have grants."""
        asked = self._requests(nodes)
        code = invite(
            self._process.home, "/fleet/**", nodes, clock.now() + _LASTS, self._address, clock.now()
        )
        before, begin = (self._service.cpu(), self._face.cpu()), time.perf_counter()
        asyncio.run(_join_all(code, list(asked.values())))
        if granted:
            self._wait_for_grants(list(asked))
        taken = time.perf_counter() - begin
        used = self._service.cpu() - before[0], self._face.cpu() - before[1]
        return Round(nodes / taken, *(1000 * seconds / nodes for seconds in used))

    def _requests(self, nodes: int) -> dict[str, bytes]:
        numbers = range(self._count, self._count + nodes)
        self._count += nodes
        names = [f"/fleet/site{number % _SITES}/new{number}" for number in numbers]
        return {name: build_request(KeySigner(generate()), "home", name) for name in names}

    def _wait_for_grants(self, names: Sequence[str]) -> None:
        end, left = time.monotonic() + _PATIENCE, set(names)
        with contextlib.closing(self._process.home.store()) as store:
            while left := {name for name in left if not store.unrevoked_grants([name])}:
                if time.monotonic() > end:
                    raise RuntimeError(f"{len(left)} nodes have no grants")
                time.sleep(0.02)


async def _join_all(code: InvitationCode, requests: list[bytes]) -> None:
    async def join_one(csr: bytes) -> None:
        await join(code, lambda _: csr, clock.now)

    async def worker() -> None:
        while requests:
            await join_one(requests.pop())

    async with asyncio.TaskGroup() as group:
        for _ in range(AT_ONCE):
            group.create_task(worker())


@contextlib.contextmanager
def _serving(*, applies: bool) -> Iterator[Authority]:
    with tempfile.TemporaryDirectory() as directory, contextlib.ExitStack() as stack:
        process = ServiceProcess(Path(directory))
        stack.callback(process.close)
        if applies:
            _fill(process)
            port = free_port()
            process.environ["ROS_MASTER_URI"] = f"http://127.0.0.1:{port}/"
            command = [sys.executable, "-I", "-m", "rossec", "master"]
            stack.enter_context(running(command, process.environ, port))
        join_port = free_port()
        options = ["--unlock-for", "0", "--join-address", f"127.0.0.1:{join_port}"]
        process.start(*options, *["--apply"] * applies)
        yield Authority(process, join_port)


def _fill(process: ServiceProcess) -> None:
    """A policy, and robots that have what it gives them."""
    policy = process.directory / NAME
    policy.write_text(_policy())
    policy.chmod(0o600)
    service = AuthorityService(process.root, lambda: PASSPHRASE, SilentMaster())
    with contextlib.closing(service):
        authority = service.unlock()
        with authority.store.transaction():
            for number in range(IDENTITIES):
                name = f"/fleet/site{number % _SITES}/robot{number}"
                enroll(authority, name, clock.now())
        service.policy.apply(service.policy.plan(read_policy(process.root, None, signs=True)))


def _policy() -> str:
    common = """rossec: 1
robot: bench
rules:
  - {id: poses, who: "/fleet/**", allow: {publish: [/fleet/pose], subscribe: [/fleet/pose]}}
  - {id: map, who: "/fleet/**", allow: {subscribe: [/map]}}
  - {id: graph, who: "/fleet/**", allow: {graph: ["/fleet/**"]}}
  - {id: camera, who: "*", deny: {subscribe: ["/camera/**"]}}
"""
    own = '  - {{id: site{0}, who: "/fleet/site{0}/*", allow: {{publish: [/site{0}/state]}}}}\n'
    return common + "".join(own.format(number) for number in range(_SITES))


def figures() -> dict[str, object]:
    """Joins a second into an empty record, and where a policy gives grants among many nodes."""
    result: dict[str, object] = {}
    for applies, name in ((False, "joins"), (True, "joins_with_policy")):
        with _serving(applies=applies) as authority:
            authority.round(AT_ONCE, granted=applies)  # first, it also makes its first round
            rounds = [authority.round(NODES, granted=applies) for _ in range(ROUNDS)]
        per_s = [each.joins_per_s for each in rounds]
        result[f"{name}_per_s"] = round(statistics.median(per_s), 1)
        result[f"{name}_per_s_range"] = [round(min(per_s), 1), round(max(per_s), 1)]
        result[f"{name}_service_cpu_ms"] = round(statistics.median(r.service_ms for r in rounds), 1)
        result[f"{name}_face_cpu_ms"] = round(statistics.median(r.face_ms for r in rounds), 1)
    return result
