"""An X server without a screen, for programs with windows; when ready, it prints its number."""

from tests.support.ports import free_port


def x_server(*options: str) -> tuple[str, ...]:
    """The command that runs it.

    Its number is nobody else's: a server that looks for one by itself sees those in its own network
    namespace only, and takes over the socket file of another, which is in /tmp for all of them.
    """
    return ("Xvfb", f":{free_port()}", "-displayfd", "1", "-screen", "0", "500x500x24", *options)
