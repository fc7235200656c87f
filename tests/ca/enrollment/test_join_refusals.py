from ca.enrollment import join_refusals
from ca.enrollment.join_messages import RefuseReason, WaitReason


def test_every_reason_has_a_message_and_a_hint() -> None:
    assert set(join_refusals.WAITING) == set(WaitReason)
    assert set(join_refusals.REFUSED) == set(join_refusals.CLAIM_REFUSED) == set(RefuseReason)
    for texts in (join_refusals.REFUSED, join_refusals.CLAIM_REFUSED):
        assert all(message and hint for message, hint in texts.values())
    assert all(message and hint for message, hint in join_refusals.WAITING.values())


def test_an_old_authority_is_not_mistaken_for_one_without_the_invitation() -> None:
    message, hint = join_refusals.CLAIM_REFUSED[RefuseReason.REFUSED]
    assert "too old" in message
    assert "--name" in hint
