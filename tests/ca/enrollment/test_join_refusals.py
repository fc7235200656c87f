from ca.enrollment import join
from ca.enrollment.join import RefuseReason, WaitReason


def test_every_reason_has_a_message_and_a_hint() -> None:
    assert set(join.WAITING) == set(WaitReason)
    assert set(join.REFUSED) == set(join.CLAIM_REFUSED) == set(RefuseReason)
    for texts in (join.REFUSED, join.CLAIM_REFUSED):
        assert all(message and hint for message, hint in texts.values())
    assert all(message and hint for message, hint in join.WAITING.values())


def test_an_old_authority_is_not_mistaken_for_one_without_the_invitation() -> None:
    message, hint = join.CLAIM_REFUSED[RefuseReason.REFUSED]
    assert "too old" in message
    assert "--name" in hint
