"""The calls that renew identities: nodes ask, the authority's service answers. Pure.

A node that has no answer yet is told so with the code 0 of ROS, a failure that is no fault of the
call: it asks again soon. The service is the authority's own node; nobody else sees requests or
leaves answers (`rossec.master.rights.access_rules`).
"""

from typing import Final

from rossec.master.api import arguments as arg
from rossec.master.api.arguments import ArgumentRefused
from rossec.master.api.methods import (
    Administered,
    CallRequest,
    Method,
    Methods,
    Reply,
    Steps,
)
from rossec.master.api.statement_calls import refusals_answered
from rossec.master.rights.identity_renewals import OFFER_LIMIT, Settlement
from rossec.master.rights.statements import TrustState
from rossec.ros.names import RENEW_IDENTITY, SETTLE_RENEWALS, WATCH_RENEWALS

_DIGEST: Final = 32
_PENDING: Final = 0


class RenewalCalls:
    """Handlers over the table of renewals in `statements`."""

    def __init__(self, statements: TrustState) -> None:
        self._statements = statements

    def methods(self) -> Methods:
        """The entries of the method table."""
        return {
            RENEW_IDENTITY: Method((arg.binary("request"),), b"", self._renew),
            WATCH_RENEWALS: Method((arg.number("locked"),), {}, self._offer),
            SETTLE_RENEWALS: Method((_settlements,), 0, self._settle),
        }

    def _renew(self, request: CallRequest) -> Reply:
        with refusals_answered():
            found = self._statements.renew_identity(request.caller, request.binary(1), request.now)
        if not found.bundle:
            return Reply(b"", f"rossec: {found.status}", _PENDING)
        return Reply(found.bundle, found.status)

    def _offer(self, request: CallRequest) -> Reply:
        renewals = self._statements.identities
        found = renewals.offer(request.now, locked=request.arguments[1] != 0)
        return Reply({"renewals": found.requests, "waiting": found.waiting}, "renewals")

    def _settle(self, request: CallRequest) -> Steps:
        """In turns: each bundle costs a signature or two."""
        settled = 0
        answers = request.arguments[1]
        for each in answers if isinstance(answers, list) else ():
            settled += self._statements.identities.settle(
                [each], request.now, self._statements.check
            )
            yield
        done = Administered(request.caller.identity, f"renewed or refused {settled} identities")
        return Reply(settled, "settled", events=(done,) if settled else ())


def is_idle(answer: object) -> bool:
    """Whether an answer to the authority's service has nothing for it to decide."""
    match answer:
        case [1, _, {"renewals": []}]:
            return True
        case _:
            return False


def _settlements(value: object, _caller: str) -> list[Settlement]:
    """[[SHA-256 of the request, bundle, reason]]; of the last two one is empty."""
    if not isinstance(value, list) or len(value) > OFFER_LIMIT:
        raise ArgumentRefused(f"ERROR: parameter [answers] must be a list of at most {OFFER_LIMIT}")
    return [_settlement(each) for each in value]


def _settlement(value: object) -> Settlement:
    match value:
        case [bytes() as digest, bytes() as bundle, str() as reason] if len(
            digest
        ) == _DIGEST and bool(bundle) is not bool(reason):
            return Settlement(digest, bundle, reason)
        case _:
            raise ArgumentRefused("ERROR: parameter [answers] has an entry of another form")
