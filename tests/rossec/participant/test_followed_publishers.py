from typing import Any

from rossec.participant.connections import FollowedPublishers

ALIAS, OWN = "/remote/hospital/pose", "/pose"


class Stream:
    def __init__(self) -> None:
        self.ended: list[str] = []

    def abort(self, reason: str) -> None:
        self.ended.append(reason)


def test_a_publisher_of_an_alias_is_left_when_it_is_listed_no_longer() -> None:
    listed = {(ALIAS, "there"), (ALIAS, "gateway")}
    followed: FollowedPublishers[str] = FollowedPublishers(lambda *which: which in listed)
    there, gateway, own, ended = streams = [Stream() for _ in range(4)]
    names: Any = (ALIAS, "there"), (ALIAS, "gateway"), (OWN, "own"), (ALIAS, "gone")
    for stream, (topic, publisher) in zip(streams, names, strict=True):
        followed.add(stream, topic, publisher)  # type: ignore[arg-type]
    followed.discard(ended)  # type: ignore[arg-type]
    followed.leave_unlisted()
    assert [len(stream.ended) for stream in streams] == [0, 0, 0, 0]
    listed.remove((ALIAS, "there"))
    for _ in range(2):
        followed.leave_unlisted()
    assert there.ended == ["the master lists this publisher no longer"]
    assert [len(stream.ended) for stream in streams] == [1, 0, 0, 0]
    for stream in streams:
        followed.discard(stream)  # type: ignore[arg-type]
    listed.clear()
    followed.leave_unlisted()
    assert (gateway.ended, own.ended) == ([], [])
