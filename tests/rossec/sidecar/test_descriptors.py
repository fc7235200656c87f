"""The descriptor limit: raised for the sidecar, restored for the program."""

import resource

import pytest

from rossec.sidecar import child

WHICH = resource.RLIMIT_NOFILE


@pytest.mark.parametrize(
    ("before", "raised"),
    [
        ((1024, 4096), [(4096, 4096)]),
        ((1024, 1 << 20), [(1 << 16, 1 << 20)]),
        ((1024, resource.RLIM_INFINITY), [(1 << 16, resource.RLIM_INFINITY)]),
        ((4096, 4096), []),
        ((1 << 17, 1 << 17), []),
        ((resource.RLIM_INFINITY, resource.RLIM_INFINITY), []),
    ],
)
def test_the_soft_limit_is_raised_as_far_as_allowed(
    monkeypatch: pytest.MonkeyPatch, before: tuple[int, int], raised: list[tuple[int, int]]
) -> None:
    made: list[tuple[int, int]] = []
    monkeypatch.setattr(resource, "getrlimit", lambda _: before)
    monkeypatch.setattr(resource, "setrlimit", lambda _, limits: made.append(limits))
    assert child.raise_limit() == before
    assert made == raised
    child.restore_limit(before)
    assert made == [*raised, before]


def test_a_limit_that_cannot_be_raised_stays(monkeypatch: pytest.MonkeyPatch) -> None:
    def forbidden(*_: object) -> None:
        raise PermissionError

    monkeypatch.setattr(resource, "getrlimit", lambda _: (1024, 4096))
    monkeypatch.setattr(resource, "setrlimit", forbidden)
    assert child.raise_limit() == (1024, 4096)
