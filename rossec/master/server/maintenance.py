"""Maintenance: rights are enforced and lists confirmed, in rounds. A shell.

A round runs at every interval, and at once when a revocation list is delivered, for what was left
to enforce. An exception in one round does not end the rounds. Each round also reads the lists of an
authority on this host, and keeps the master's own identity current. Gateways are asked meanwhile.
"""

import asyncio
import contextlib
import errno
import logging
from collections.abc import Callable
from typing import Final, TypeAlias

from ca.certificates import Identity, renew_at, retry_delay, sign_renewal
from ca.errors import HintedError
from ca.names import is_in_gateway
from ca.revocation.lists import is_tree
from ca.svid import build_request
from grants.model import format_time
from rossec.channel.edhoc.credentials import LiveCredentials
from rossec.clock import Setbacks
from rossec.errors import AnswerRefused, ConfigurationError, RossecError
from rossec.home import NodeHome
from rossec.host.runner import TaskSet
from rossec.master.api.methods import DomainsChanged, RevocationsChanged
from rossec.master.rights import renewals, statements
from rossec.master.server.effects import Effects, MasterState
from rossec.master.server.saved_state import ParameterFile
from rossec.master.server.updates import SlaveClient
from rossec.master.state.registry import Kind, NodeRef
from rossec.peer_limits import printable
from rossec.ros.xmlrpc import Fault

SOURCE: Final = "the authority on this host"

_log = logging.getLogger("rossec.master.discovery")

# Returns the newest signed list or tree, and the entries of a tree; None: unchanged
FindRevocations: TypeAlias = Callable[[], tuple[bytes, bytes] | None]
# Returns the newest signed list of domains; empty: unchanged, or there is none
FindDomains: TypeAlias = Callable[[], bytes]


def no_authority() -> None: ...


def no_domains() -> bytes:
    return b""


class LocalAuthority:
    """Reads the lists of an authority on the master's host, from its directory."""

    # A list that could not be delivered, as the master was not running or not reachable, would otherwise wait
    # for a person, while the master keeps confirming the old one. An invalid list is logged, and the list in
    # force stays.
    def __init__(
        self, find: FindRevocations, trust: statements.TrustState, find_domains: FindDomains = no_domains
    ) -> None:
        self._find = find  # find, find_domains: read the directory. They raise `HintedError` or `OSError`
        self._trust = trust
        self._find_domains = find_domains
        self._last_warnings: dict[str, str] = {}  # by what was looked for

    def has_newer_list(self, now: int) -> bool:
        def accept() -> bool:
            found = self._find()
            if found is not None and is_tree(found[0]):
                return self._trust.update_tree(*found, now)
            return found is not None and self._trust.update(found[0], now)

        return self._take("list", accept)

    def has_newer_domains(self) -> bool:
        find, update = self._find_domains, self._trust.update_domains
        return self._take("list of domains", lambda: (data := find()) != b"" and update(data))

    def _take(self, what: str, accept: Callable[[], bool]) -> bool:
        try:
            newer = accept()
        except (HintedError, OSError) as error:
            reason = printable(error)
            if reason != self._last_warnings.get(what):
                _log.warning("the %s of %s is not accepted: %s", what, SOURCE, reason)
            self._last_warnings[what] = reason
            return False
        self._last_warnings.pop(what, None)
        return newer


_HOUR: Final = 3600
_RETRY: Final = 600
_GRACE: Final = 60  # seconds at most for the first answer
_own_identity_log = logging.getLogger("rossec.master.own")

# Answers a renewal request with the new bundle, or with what is waited for
Renew = Callable[[bytes, int], renewals.RenewalAnswer]


class OwnIdentity:
    """The credentials of the master; `check` keeps them current."""

    # A master runs for months, its certificate is valid for one. So it reloads a certificate that was
    # installed (`rossec node install`) and has its own renewed like that of any node, by the authority's
    # service or by an intermediate here; while that does not succeed, it logs a warning. The key stays the
    # same: nodes identify their master by it.
    def __init__(self, home: NodeHome, now: int) -> None:
        self._home = home
        self._identity = home.identity(now)
        self._loaded_version = self._file_version()
        self._next_attempt = self._next_warning = 0
        self._csr = b""
        self.renew: Renew | None = None
        self.credentials = LiveCredentials(home.credentials())

    def check(self, now: int) -> None:
        self._attempt(self._reload, now)
        held = self._identity
        if now >= max(self._next_attempt, renew_at(held.not_before, held.not_after)):
            self._next_attempt = now + retry_delay(held.not_before, held.not_after, _RETRY)
            self._attempt(self._renew, now)

    def _attempt(self, action: Callable[[int], None], now: int) -> None:
        try:
            action(now)
        except (HintedError, OSError) as error:
            hint = f" ({error.hint})" if isinstance(error, HintedError) and error.hint else ""
            _own_identity_log.warning("the master's own identity: %s%s", printable(error), hint)

    def _reload(self, now: int) -> None:
        version = self._file_version()
        if version == self._loaded_version:
            return
        self._loaded_version = version
        found = self._home.identity(now)
        if found.thumbprint != self._identity.thumbprint:
            raise ConfigurationError("the installed identity has another key", "restart the master")
        self._replace(found)

    def _replace(self, identity: Identity) -> None:
        self.credentials.current = self._home.credentials()
        self._identity, self._csr = identity, b""
        self._next_attempt = self._next_warning = 0
        _own_identity_log.info("the master's own identity is valid until %s", format_time(identity.not_after))

    def _renew(self, now: int) -> None:
        own, held = self.credentials.current, self._identity
        if now > held.not_after or self.renew is None:
            self._warn("", now)
            return
        self._csr = self._csr or build_request(own.signer, held.domain, held.name)
        answer = self.renew(sign_renewal(own.signer, own.chain, self._csr, now), now)
        if answer.bundle:
            self._replace(self._home.install(answer.bundle, now))
            self._loaded_version = self._file_version()
            return
        self._next_attempt = now + 1  # in the next round, or as soon as there is an answer
        self._warn(f": {answer.status}", now)

    def _warn(self, why: str, now: int) -> None:
        # Once an hour, but not before a service that runs had time to answer.
        held = self._identity
        if not self._next_warning and why:
            self._next_warning = now + retry_delay(held.not_before, held.not_after, _GRACE)
        if now < self._next_warning:
            return
        self._next_warning = now + retry_delay(held.not_before, held.not_after, _HOUR)
        verb, option = ("expires", "") if now <= held.not_after else ("expired", "--expired ")
        raise ConfigurationError(
            f"it {verb} {format_time(held.not_after)}, after which no node connects{why}",
            f"rossec ca renew {option}{held.name}, then rossec node install FILE here; no restart",
        )

    def _file_version(self) -> tuple[int, int, int]:
        found = (self._home.path / "node.pem").stat()
        return found.st_ino, found.st_mtime_ns, found.st_size


ASK_EVERY: Final = 2.0  # seconds
RETRY_AFTER: Final = 1.0
ANSWER_WITHIN: Final = 4.0
SILENT_AFTER: Final = 5.0  # since the last answer
_FAILURES: Final = 2  # at least: a master that was stopped itself has asked nobody

_gateways_log = logging.getLogger("rossec.master.gateways")
_audit = logging.getLogger("rossec.audit")


class Gateways:
    """Gateways that have died: noticed, so that subscribers do not wait for them."""

    # A gateway replaces the origin's publishers, so nobody else would notice. Each one that serves a topic is
    # asked for its process id, on one connection that stays: the end of a process ends it at once. One
    # without an answer is silent, and serves nothing until it answers again; where nobody listens at its
    # address any more it is unregistered. A master where nothing is served asks nobody.
    def __init__(self, state: MasterState, effects: Effects) -> None:
        self._state = state
        self._effects = effects
        self._asked: set[NodeRef] = set()
        self._tasks = TaskSet()

    def __len__(self) -> int:
        return len(self._asked)

    def start(self) -> None:
        self._effects.on_served = self._served

    async def close(self) -> None:
        await self._tasks.close()

    def _served(self, topic: str) -> None:
        for node in self._state.registry.registered_nodes(Kind.PUBLISHER, topic):
            if node not in self._asked:
                self._asked.add(node)
                self._tasks.spawn(self._ask(node), f"asking {node.name}")

    async def _ask(self, node: NodeRef) -> None:
        client, loop = SlaveClient(node, self._effects.dialer.dial, ANSWER_WITHIN), asyncio.get_running_loop()
        heard, failures = loop.time(), 0
        try:
            while self._topics(node):
                error = await self._error_of(client, node)
                if error is None:
                    heard, failures = loop.time(), 0
                    self._note(node, silent=False)
                else:
                    failures += 1
                    if failures >= _FAILURES and loop.time() - heard >= SILENT_AFTER:
                        if not _is_refused(error):
                            self._note(node, silent=True)
                        elif self._state.registry.is_current(node):
                            _audit.warning("%s is unregistered: nobody listens at %s", node.name, node.uri)
                            for event in self._state.registry.remove_node(node.name):
                                self._effects.deliver(event)
                            self._state.notify()
                await asyncio.sleep(RETRY_AFTER if failures else ASK_EVERY)
        finally:
            self._asked.discard(node)
            await client.close()

    async def _error_of(self, client: SlaveClient, node: NodeRef) -> Exception | None:
        # Why a gateway does not answer; None: it does, whatever it says.
        try:
            await client.ask("getPid", self._state.name)
        except (Fault, AnswerRefused):
            return None
        except (RossecError, OSError, TimeoutError) as error:
            _gateways_log.info("%s does not answer: %s", node.name, printable(error))
            await client.close()
            return error
        return None

    def _note(self, node: NodeRef, *, silent: bool) -> None:
        if not self._state.registry.set_silent(node, silent=silent):
            return
        _audit.warning("%s %s", node.name, "does not answer" if silent else "answers again")
        for topic in self._topics(node):
            changes = self._state.aliases.changes(topic, self._state.now())
            self._effects.send_publishers(changes)
        self._state.notify()

    def _topics(self, node: NodeRef) -> list[str]:
        registry = self._state.registry
        keys = registry.keys_of(node.name, Kind.PUBLISHER) if registry.is_current(node) else ()
        return [key for key in keys if is_in_gateway(key)]


def _is_refused(error: BaseException | None) -> bool:
    # Whether nobody listens at the address: the process is gone, not just out of reach.
    while error is not None:
        if isinstance(error, OSError) and error.errno == errno.ECONNREFUSED:
            return True
        error = error.__cause__
    return False


_CLOCK_SET_BACK: Final = (
    "the host's clock went back: the master counts the seconds that have passed instead"
    " (set the clock right; if it is right now, restart the master)"
)

_SAVE_PAUSE: Final = 1.0  # seconds between two times that parameters are saved, however many
_maintenance_log = logging.getLogger("rossec.master.maintenance")


class Maintenance:
    def __init__(
        self,
        state: MasterState,
        effects: Effects,
        interval: float,
        check_own_identity: Callable[[int], None],
        local_authority: LocalAuthority,
    ) -> None:
        self._state = state
        self._effects = effects
        self._interval = interval
        self._check_own_identity = check_own_identity
        self._local_authority = local_authority
        self._setbacks = Setbacks()
        state.aliases.on_slot = effects.list_changed.set
        self._tasks = TaskSet()

    def start(self, keep_views: Callable[[frozenset[bytes]], None]) -> None:
        self._tasks.spawn(self._run(keep_views), name="rossec master maintenance")
        if self._state.parameter_file is not None:
            saving = self._save(self._state.parameter_file)
            self._tasks.spawn(saving, name="rossec master parameters")

    async def close(self) -> None:
        await self._tasks.close()

    async def _run(self, keep_views: Callable[[frozenset[bytes]], None]) -> None:
        while True:
            self._effects.list_changed.clear()
            try:
                await self._run_once()
                keep_views(self._connected_keys())
            except Exception:  # noqa: BLE001 - one failure must not end freshness and enforcement
                _maintenance_log.exception("maintenance failed; it is tried again")
            with contextlib.suppress(TimeoutError):
                async with asyncio.timeout(self._pause()):
                    await self._effects.list_changed.wait()

    def _pause(self) -> float:
        now = self._state.now()
        moments = self._state.trust.domains.next_end(now), self._state.aliases.next_slot(now)
        waits = [moment - self._state.clock() for moment in moments if moment is not None]
        return min(self._interval, *waits) if waits else self._interval

    async def _run_once(self) -> None:
        if self._setbacks.any_new():
            _audit.warning(_CLOCK_SET_BACK)
        # 1. Rights are enforced piece by piece: calls are answered between two steps.
        self._effects.close_revoked()
        for _ in self._effects.enforcement():
            self._state.notify()
            await asyncio.sleep(0)
        for updates in self._state.aliases.all_changes(self._state.now()):
            self._effects.send_publishers(updates)
            await asyncio.sleep(0)
        self._state.notify_all()  # rights also narrow what watchers see
        # 2. Nodes are told that the list is still the newest, and what nobody needs is forgotten.
        self._effects.send_revocations()
        self._effects.drop_deposits()
        nodes = frozenset(self._state.registry.nodes())
        self._effects.updates.prune(nodes)
        keys = self._connected_keys() | {node.thumbprint for node in nodes}
        self._state.trust.keep_only(keys, self._state.now())
        # 3. The own identity, and what an authority on this host has signed since.
        self._check_own_identity(self._state.now())
        if self._local_authority.has_newer_list(self._state.now()):
            self._effects.deliver(RevocationsChanged(SOURCE))
        if self._local_authority.has_newer_domains():
            self._effects.deliver(DomainsChanged(SOURCE))
        if self._state.deposit_file is not None:
            self._state.deposit_file.sync()

    async def _save(self, file: ParameterFile) -> None:
        while True:
            with contextlib.suppress(TimeoutError):
                async with asyncio.timeout(self._interval):
                    await file.grown.wait()
            try:
                await file.save()
            except Exception:  # noqa: BLE001 - as above
                _maintenance_log.exception("parameters were not saved; it is tried again")
            await asyncio.sleep(min(_SAVE_PAUSE, self._interval))  # also after a failure

    def _connected_keys(self) -> frozenset[bytes]:
        return frozenset(stream.peer.thumbprint for stream in self._state.streams)
