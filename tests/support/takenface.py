"""A network face that was taken over: it ends its connection, stays, and asks for the status."""

import os
import sys
import time
from pathlib import Path

from rossec.authority.keyservice.client import KeyServiceClient
from rossec.authority.keyservice.messages import STATUS, ServiceRequest

WAIT = 0.3  # seconds in which the service sees that the connection ended


def main(descriptor: str, _: str, directory: str, answer: str, *__: str) -> None:
    """Write to the file `answer` what the service in `directory` said."""
    os.close(int(descriptor))
    time.sleep(WAIT)
    try:
        client = KeyServiceClient.find(Path(directory))
        said = "no service" if client is None else str(client.ask(ServiceRequest(STATUS)))
    except Exception as error:  # noqa: BLE001 - whatever it is, the test shows it
        said = repr(error)
    partial = Path(answer).with_suffix(".part")
    partial.write_text(said)
    partial.rename(answer)
    time.sleep(60)


if __name__ == "__main__":
    main(*sys.argv[1:])
