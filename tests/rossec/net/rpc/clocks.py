"""A clock for turns."""


class Ticks:
    """Goes on by `step` with each look."""

    def __init__(self, step: float = 1) -> None:
        self._now = 0.0
        self._step = step

    def __call__(self) -> float:
        self._now += self._step
        return self._now
