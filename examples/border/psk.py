"""OSCORE for a thing without curves: a context anew after each start (RFC 8613 appendix B.2).

Nothing is written to flash: the thing contributes ID1 and R3, the border router R2.
"""

import os
from pathlib import Path

import cbor2
from aiocoap import oscore


class Derived(oscore.CanProtect, oscore.CanUnprotect, oscore.SecurityContextUtils):
    alg_aead = oscore.algorithms["AES-CCM-16-64-128"]
    hashfun = oscore.hashfunctions["sha256"]
    echo_recovery = None

    def __init__(self, kid, secret, value):
        self.secret, self.value = secret, value
        self.sender_id, self.recipient_id, self.id_context = kid, b"", value
        self.derive_keys(b"", secret)
        self.id_context = cbor2.dumps(value)  # as it is sent
        self.sender_sequence_number = 0
        self.recipient_replay_window = oscore.ReplayWindow(32, lambda: None)
        self.recipient_replay_window.initialize_empty()

    def post_seqnoincrease(self):
        """Nothing to store: a sequence number is of this start only."""

    def context_from_response(self, unprotected):
        sent = unprotected.get(oscore.COSE_KID_CONTEXT)
        if sent is None:
            return self
        answer = Derived(self.sender_id, self.secret, cbor2.loads(sent) + self.value)
        answer.id_context = sent
        return answer

    def next(self):
        """The context to go on with, of the one in which the border router answered."""
        return Derived(self.sender_id, self.secret, self.value[:16] + os.urandom(8))


def first(file):
    """The context of a first request, with what `rossec border add --psk` wrote."""
    _, kid, secret = Path(file).read_text().strip().split(":")
    return Derived(bytes.fromhex(kid), bytes.fromhex(secret), os.urandom(8))
