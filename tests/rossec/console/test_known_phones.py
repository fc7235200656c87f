"""Sessions of phones that were removed."""

import pytest

from rossec.authority.console.messages import PhoneView
from rossec.console.sessions import KEPT, KnownPhones, LoginSession
from rossec.errors import KeyServiceFailed

ANN = PhoneView(b"1", "Ann's phone", 100, 0, "", "")


def session() -> LoginSession:
    return LoginSession(b"s", ANN.name, 100, 100)


class Service:
    def __init__(self) -> None:
        self.phones, self.asked, self.elapsed = [ANN], 0, 0.0
        self.is_there = True
        self.known = KnownPhones(self.ask, lambda: self.elapsed)

    async def ask(self) -> tuple[PhoneView, ...]:
        if not self.is_there:
            raise KeyServiceFailed("it does not answer", "start it")
        self.asked += 1
        return tuple(self.phones)


@pytest.fixture
def service() -> Service:
    return Service()


async def test_a_phone_that_is_there_counts_and_is_not_asked_for_all_the_time(service: Service) -> None:
    ann = session()
    for _ in range(3):
        assert await service.known.counts(ann)
    assert service.asked == 1


async def test_one_that_was_removed_does_not_count_any_more(service: Service) -> None:
    assert await service.known.counts(session())
    service.phones = [ANN._replace(ended="stolen")]
    service.elapsed += KEPT
    assert not await service.known.counts(session())


async def test_another_one_of_its_name_does_not_bring_its_session_back(service: Service) -> None:
    ann = session()
    assert await service.known.counts(ann)
    service.phones = [ANN._replace(ended="stolen"), ANN._replace(id=b"2", at=101)]
    service.elapsed += KEPT
    assert not await service.known.counts(ann)
    assert await service.known.counts(session()), "a new login by the new one does"


async def test_one_that_was_set_up_just_now_counts(service: Service) -> None:
    assert await service.known.counts(session())
    service.phones.append(PhoneView(b"2", "Ben's phone", 101, 0, "", ""))
    assert await service.known.counts(LoginSession(b"t", "Ben's phone", 101, 101))


async def test_a_session_by_a_code_has_no_phone(service: Service) -> None:
    assert await service.known.counts(LoginSession(b"t", "", 100, 100))
    assert service.asked == 0


async def test_no_session_counts_while_the_service_does_not_answer(service: Service) -> None:
    assert await service.known.counts(session())
    service.elapsed += KEPT
    service.is_there = False
    with pytest.raises(KeyServiceFailed):
        await service.known.counts(session())
