import resource

import pytest

from rossec.master.operation.admin import raise_descriptor_limit


@pytest.mark.parametrize(
    ("limits", "expected"),
    [
        ((1024, 1 << 20), (65536, 1 << 20)),
        ((1024, 4096), (4096, 4096)),
        ((1024, resource.RLIM_INFINITY), (65536, resource.RLIM_INFINITY)),
        ((1 << 17, 1 << 20), None),
        ((resource.RLIM_INFINITY, resource.RLIM_INFINITY), None),
    ],
)
def test_the_soft_limit_is_raised_as_far_as_the_hard_one_allows(
    monkeypatch: pytest.MonkeyPatch, limits: tuple[int, int], expected: tuple[int, int] | None
) -> None:
    changes: list[tuple[int, int]] = []
    monkeypatch.setattr(resource, "getrlimit", lambda _: limits)
    monkeypatch.setattr(resource, "setrlimit", lambda _, limit: changes.append(limit))
    raise_descriptor_limit()
    assert changes == ([] if expected is None else [expected])
