"""A node that connects to itself: its own certificate is accepted there, and nowhere else.

ROS programs subscribe to their own topics and call their own services. Anywhere else the own
certificate is a reflection (the selfie attack, ePrint 2019/347): a redirect would connect a node to
itself instead of another one. So a dial that is meant for the node itself is noted by its G_X, the
responder that receives that G_X adds its G_Y, and both sides check for exactly this pair.
Forwarding, repeating or redirecting messages does not change the pair, and another process with the
same key is not found here.
"""

from weakref import WeakValueDictionary


class Dial:
    """One dial that is meant for this node; held by the dialer, and forgotten with it."""

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
        """Note a dial that is meant for this node; it lasts as long as the object returned."""
        dial = self._pending[g_x] = Dial()
        return dial

    def answer(self, g_x: bytes, g_y: bytes) -> None:
        """Note the answer of this node, if the dial is one of its own: the first one counts."""
        dial = self._pending.get(g_x)
        if dial is not None and dial.g_y is None:
            dial.g_y = g_y

    def is_own(self, g_x: bytes, g_y: bytes) -> bool:
        """Whether this node dialled itself with `g_x` and answered with `g_y`."""
        dial = self._pending.get(g_x)
        return dial is not None and dial.g_y == g_y
