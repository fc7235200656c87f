"""What a node says about an answer that is not its identity: message and hint for each reason."""

from typing import Final

from ca.enrollment.join_messages import RefuseReason, WaitReason

_AGAIN: Final = "then run `rossec node join` again: the same request gets its answer"
WAITING: Final = {
    WaitReason.LOCKED: ("the authority is locked", f"at the authority: rossec ca unlock; {_AGAIN}"),
    WaitReason.PERSON: (
        "a person has to approve this: the name is known with another key",
        f"at the authority: rossec ca requests, and approve; {_AGAIN}",
    ),
}
REFUSED: Final = {
    RefuseReason.REFUSED: (
        "the authority does not know this invitation",
        "of another authority, or from before a restore? another one: rossec ca invite PATTERN",
    ),
    RefuseReason.ENDED: (
        "the invitation has expired, was revoked, or is used up",
        "at the authority: rossec ca invitations; another one: rossec ca invite PATTERN",
    ),
    RefuseReason.NAME: (
        "the invitation does not allow this name",
        "give a name within its pattern that no other node has: --name",
    ),
    RefuseReason.REQUEST: (
        "the authority does not accept this request", "move the node's directory away and try again"
    ),
    RefuseReason.DENIED: (
        "this request was denied, or its key is revoked",
        "move the node's directory away and join with a new key",
    ),
    RefuseReason.BUSY: (
        "too many nodes are joining, or too many requests wait", "try again in a minute"
    ),
    RefuseReason.UNNAMED: (
        "the authority has no rules that give names",
        "give the name: --name; or at the authority: rossec ca serve --rules FILE",
    ),
    RefuseReason.METADATA: (
        "the authority's rules give no name for these metadata",
        "try them with the same rules: rossec namespace name FILE; its log says why",
    ),
}  # fmt: skip
CLAIM_REFUSED: Final = {
    **REFUSED,
    RefuseReason.REFUSED: (
        "the authority does not know this invitation, or is too old to give names",
        "join with a name: --name; or update the authority",
    ),
    RefuseReason.NAME: (
        "the authority's rules give another name, or one that the invitation does not allow",
        "see which: rossec namespace name FILE; then correct the metadata or the invitation",
    ),
}
