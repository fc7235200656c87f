"""CPU seconds that `rossec policy apply` takes for one changed rule, by the number of nodes.

The rule is for every node, so each of them gets a new grant and loses one; their other grants are
kept. The record is on the disk; deliveries are made up, and cost the master nothing here.
"""

import contextlib
import secrets
import tempfile
import time
from pathlib import Path

from ca.keys.private_keys import generate
from ca.keys.signing import KeySigner
from ca.svid import build_request
from grants.document import grant_id
from grants.model import ID_SIZE
from rossec.authority.home import AuthorityHome
from rossec.authority.policyfile import NAME, read_policy
from rossec.authority.service import AuthorityService
from rossec.authority.session import StatementCall
from rossec.authority.signing import SigningAuthority, certificate_row

SIZES = (30, 300, 3000)
_PASSPHRASE = "four random words here"
_RULES = """rossec: 1
robot: bench
types: {/map: nav_msgs/OccupancyGrid, /fleet/pose: geometry_msgs/PoseStamped}
rules:
  - {id: poses, who: "/fleet/**", allow: {publish: [/fleet/pose], subscribe: [/fleet/pose]}}
  - {id: map, who: "/fleet/**", allow: {subscribe: [/map]}, CHANGED}
  - {id: graph, who: "/fleet/**", allow: {graph: ["/fleet/**"]}}
  - {id: dock, who: "/fleet/**", prompt: {call: [/dock]}}
  - {id: camera, who: "*", deny: {subscribe: ["/camera/**"]}}
"""


def apply_s(nodes: int) -> dict[str, float]:
    """CPU seconds of an apply of one changed rule for all of `nodes`, and of one without change."""
    with tempfile.TemporaryDirectory() as directory:
        root = Path(directory)
        with contextlib.closing(_service(root, nodes)) as service:
            _write(root, "why: first")
            _apply(root, service)
            _write(root, "limit: {rate: 1}")
            changed = _timed(root, service)
            return {"changed": changed, "unchanged": _timed(root, service)}


def _service(root: Path, nodes: int) -> AuthorityService:
    now = int(time.time())
    AuthorityHome.create(root, "home", _PASSPHRASE, now)
    service = AuthorityService(root, lambda: _PASSPHRASE, SilentMaster(), lambda: now)
    authority = service.unlock()
    with authority.store.transaction():
        for number in range(nodes):
            enroll(authority, f"/fleet/robot{number}", now)
    return service


def enroll(authority: SigningAuthority, name: str, now: int) -> None:
    """Record an identity for `name`, with a key of its own that is forgotten."""
    request = build_request(KeySigner(generate()), "home", name)
    der = authority.authority.issue(request, now=now, serial=secrets.randbits(127) + 1)
    authority.store.add_certificate(certificate_row(authority.verify(der, now)), now)


class SilentMaster:
    """Takes everything at once; what it costs a master is not in the figure."""

    def __init__(self) -> None:
        self._known: set[bytes] = set()

    def __call__(self, call: StatementCall) -> object:
        (items, *_) = call.statement
        if not isinstance(items, list):
            return 0  # the revocation list
        if call.method == "rossec.deliveryStates":
            return ["waiting" if item[:ID_SIZE] in self._known else "" for item in items]
        self._known.update(map(grant_id, items))
        return ["" for _ in items]


def _write(root: Path, changed: str) -> None:
    path = root / "ca" / NAME
    path.write_text(_RULES.replace("CHANGED", changed))
    path.chmod(0o600)


def _apply(root: Path, service: AuthorityService) -> None:
    plan = service.policy.plan(read_policy(root, None, signs=True))
    if not plan.is_empty:
        service.policy.apply(plan)


def _timed(root: Path, service: AuthorityService) -> float:
    begin = time.process_time()
    _apply(root, service)
    return round(time.process_time() - begin, 3)
