"""Every way an identity, a key or a signed statement can be refused.

One line says what happened, `hint` says what to do about it. The leaves say whose fault it
is: the file's owner, the peer, or the operator. `HintedError` is the common shape of the three
error roots (`CAError`, `GrantError`, `RossecError`); a command line needs to catch only that.
"""


class HintedError(Exception):
    """A refusal with a remedy.

    Args:
        message: one line, lower case, no full stop: what happened.
        hint: one line: what the reader can do about it. May be empty.
    """

    def __init__(self, message: str, hint: str = "") -> None:
        super().__init__(message)
        self.hint = hint


class CAError(HintedError):
    """Root of everything `ca` refuses."""


class EncodingError(CAError):
    """Bytes that are not the one deterministic CBOR encoding of an allowed value."""


class SignatureError(CAError):
    """A signed statement whose frame is wrong or whose signature does not verify."""
