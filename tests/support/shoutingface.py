"""A network face that was taken over: its error is not one line of text."""

import socket
import sys

from rossec.authority.keyservice import messages
from rossec.authority.keyservice.messages import InnerRequest

SHOUT = "\x1b[2Jcannot listen\nauthority of site: unlocked"

if __name__ == "__main__":
    with socket.socket(fileno=int(sys.argv[1])) as inner:
        inner.sendall(messages.write(InnerRequest(0, messages.FAILED, (SHOUT, SHOUT))))
        inner.recv(1)
