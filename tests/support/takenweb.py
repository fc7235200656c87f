"""A web process that was taken over: it says what the supervisor says, and does not end."""

import signal
import socket
import sys
import time

from rossec.console.server.control import CERTIFICATE, ControlMessage, write

if __name__ == "__main__":
    signal.signal(signal.SIGTERM, signal.SIG_IGN)
    with socket.socket(fileno=int(sys.argv[1].partition(",")[0])) as control:
        control.sendall(write(ControlMessage(CERTIFICATE, (b"mine",))))
        time.sleep(600)
