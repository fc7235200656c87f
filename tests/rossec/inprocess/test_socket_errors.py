import errno

import pytest

from rossec.errors import ChannelClosed
from rossec.inprocess.sockets import resets, tried_again


@pytest.mark.parametrize("number", [errno.ECONNRESET, errno.EPIPE, errno.ENOTCONN])
def test_a_reset_while_connecting_is_one_that_rospy_tries_again(number: int) -> None:
    with pytest.raises(ConnectionAbortedError, match="it said") as caught, tried_again():
        raise OSError(number, "it said")
    assert caught.value.errno == errno.ECONNABORTED


@pytest.mark.parametrize("number", [errno.ECONNREFUSED, errno.EHOSTUNREACH])
def test_other_errors_of_a_socket_stay_as_they_are(number: int) -> None:
    with pytest.raises(OSError, match="it said") as caught, tried_again():
        raise OSError(number, "it said")
    assert caught.value.errno == number
    with pytest.raises(ChannelClosed), tried_again():
        raise ChannelClosed("gone")
    with pytest.raises(TimeoutError), tried_again():
        raise TimeoutError("late")


def test_an_error_of_the_channel_is_a_reset_for_rospy() -> None:
    with pytest.raises(ConnectionResetError, match="rossec: gone") as caught, resets():
        raise ChannelClosed("gone")
    assert caught.value.errno == errno.ECONNRESET
