"""The calls about foreign domains: the list of them, and what their authorities revoked. Pure.

What is delivered here is signed by the own authority, what is answered by the one it is of: a node
verifies all of it. Foreigners ask their own master.
"""

from typing import Final

from rossec.master.api import arguments as arg
from rossec.master.api.methods import CallRequest, DomainsChanged, Method, Methods, Reply
from rossec.master.api.statement_calls import PROOF_LIMIT, binaries, refusals_answered
from rossec.master.rights.caller import Refused
from rossec.master.rights.statements import TrustState
from rossec.ros.names import (
    DOMAINS,
    FOREIGN_PROOFS,
    FOREIGN_REVOCATIONS,
    UPDATE_DOMAINS,
)

MAX_DOMAIN: Final = 255  # characters


class DomainCalls:
    """Handlers over what a `TrustState` knows of other domains."""

    def __init__(self, statements: TrustState) -> None:
        self._statements = statements

    def methods(self) -> Methods:
        """The entries of the method table."""
        domain, digest = arg.text("domain"), arg.binary("digest")
        entries = arg.binaries("entries", PROOF_LIMIT)
        return {
            DOMAINS: Method((digest,), b"", self._domains),
            UPDATE_DOMAINS: Method((arg.binary("list"),), 0, self._update),
            FOREIGN_REVOCATIONS: Method((domain, digest), [], self._revocations),
            FOREIGN_PROOFS: Method((domain, entries), [], self._proofs),
        }

    def _domains(self, request: CallRequest) -> Reply:
        domains = self._statements.domains
        held = request.binary(1) == domains.digest()
        return Reply(b"" if held else domains.anchors.data, "domains")

    def _update(self, request: CallRequest) -> Reply:
        with refusals_answered():
            newer = self._statements.update_domains(request.binary(1))
        if not newer:
            return Reply(0, "not newer than the list in force")
        changed = DomainsChanged(request.caller.identity)
        return Reply(1, "domains updated", events=(changed,))

    def _revocations(self, request: CallRequest) -> Reply:
        word = self._statements.domains.word(self._listed(request))
        held = request.binary(2) == word.digest()
        answer = [b"" if held else word.revocations, word.timestamp, list(word.chain)]
        return Reply(answer, "revocations")

    def _proofs(self, request: CallRequest) -> Reply:
        domain = self._listed(request)
        entries = binaries(request.arguments[2])
        return Reply(self._statements.domains.proofs(domain, entries), "proofs")

    def _listed(self, request: CallRequest) -> str:
        domain = request.text(1)[:MAX_DOMAIN]
        if self._statements.domains.anchors.listed_domain(domain) is None:
            raise Refused(f"domain {domain!a} is not listed here")
        return domain
