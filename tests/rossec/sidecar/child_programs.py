"""Child processes that open files and connections on request."""

import contextlib
import socket
import subprocess
import sys
from collections.abc import Iterator

# Opens files, then makes one connection for each line it is sent; closes them on request.
PROGRAM = """
import os, socket, sys
files = [open(os.devnull) for _ in range(int(sys.argv[2]))]
socks = []
for line in sys.stdin:
    if line == "close\\n":
        socks.pop().close()
    else:
        socks.append(socket.create_connection(("127.0.0.1", int(sys.argv[1]))))
    print("done", flush=True)
"""


class Programs:
    """Child processes that connect to one port."""

    def __init__(self, count: int, files: int) -> None:
        self.server = socket.create_server(("127.0.0.1", 0), backlog=256)
        command = (sys.executable, "-S", "-c", PROGRAM, str(self.server.getsockname()[1]))
        self.running = [
            subprocess.Popen((*command, str(files)), stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
            for _ in range(count)
        ]

    def send_line(self, index: int, line: str) -> None:
        program = self.running[index]
        assert program.stdin is not None
        assert program.stdout is not None
        program.stdin.write(line + "\n")
        program.stdin.flush()
        assert program.stdout.readline() == "done\n"

    def connection(self, index: int) -> socket.socket:
        self.send_line(index, "connect")
        return self.server.accept()[0]

    def close(self) -> None:
        for program in self.running:
            program.kill()
            program.communicate()
        self.server.close()


@contextlib.contextmanager
def programs(count: int = 1, files: int = 0) -> Iterator[Programs]:
    started = Programs(count, files)
    try:
        yield started
    finally:
        started.close()
