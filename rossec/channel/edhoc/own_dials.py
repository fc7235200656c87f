"""A node that calls itself: it may meet its own certificate where it meant to, and nowhere else.

ROS programs listen to their own topics and call their own services. Anywhere else the own
certificate is a reflection (the selfie attack, ePrint 2019/347): a redirect would make a node hear
itself instead of somebody else. So a dial that is meant for the node itself is noted by its G_X,
the responder that is asked with that G_X adds its G_Y, and both sides look for exactly this pair.
Who forwards, repeats or redirects messages changes nothing in that, and another process with the
same key is not found here.
"""

from weakref import WeakValueDictionary


class Dial:
    """One dial that is meant for this node; held by whoever dials, and forgotten with that."""

    __slots__ = ("__weakref__", "g_y")

    def __init__(self) -> None:
        self.g_y: bytes | None = None


class OwnDials:
    """The pending dials of one node that are meant for itself; threads may share it."""

    def __init__(self) -> None:
        self._pending: WeakValueDictionary[bytes, Dial] = WeakValueDictionary()

    def __len__(self) -> int:
        return len(self._pending)

    def begin(self, g_x: bytes) -> Dial:
        """Note a dial that is meant for this node; it lasts as long as what is returned."""
        dial = self._pending[g_x] = Dial()
        return dial

    def answer(self, g_x: bytes, g_y: bytes) -> None:
        """Note the answer of this node, if the dial is one of its own: the first one counts."""
        dial = self._pending.get(g_x)
        if dial is not None and dial.g_y is None:
            dial.g_y = g_y

    def is_own(self, g_x: bytes, g_y: bytes) -> bool:
        """Whether this node dialled with `g_x`, for itself, and answered that with `g_y`."""
        dial = self._pending.get(g_x)
        return dial is not None and dial.g_y == g_y
