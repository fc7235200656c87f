"""The policy file of an authority, read with the message types known on this host.

It adds I/O to `grants.policy.read`. By default the file is `policy.yaml` next to the authority's
key; without a file there is no policy, and it permits nothing.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Final, Self

from grants.policy.decision import Decider
from grants.policy.model import Policy
from grants.policy.read import load
from grants.policy.source import MAX_SIZE
from rossec import files
from rossec.authority.home import AuthorityHome
from rossec.errors import ConfigurationError
from rossec.participant.host_types import definition_of, layout_of
from rossec.participant.message_types import type_names

__all__ = ["NAME", "PolicyFile", "layout_of", "parse_policy", "place", "read_policy"]

NAME: Final = "policy.yaml"
OWNED: Final = (files.Owned(r"policy\.yaml", stays=True),)


@dataclass(frozen=True)
class PolicyFile:
    """A policy with its text and its path."""

    path: Path
    text: str
    policy: Policy

    @classmethod
    def read(cls, path: Path, *, own: bool = False) -> Self:
        """Read the policy in `path`; with `own`, only if no other user can write it.

        Raises:
            ConfigurationError: there is no such file, or it is not UTF-8.
            PathRefused: another user could have written it.
            PolicyRefused: with all its mistakes.
        """
        missing = ConfigurationError(f"there is no policy in {path}", "next: rossec policy init")
        try:
            text = (
                files.read_own(path, MAX_SIZE, missing, link=True)
                if own else files.read(path, MAX_SIZE, missing)
            ).decode()  # fmt: skip
        except UnicodeDecodeError:
            raise ConfigurationError(f"{path} is not UTF-8", "is it the right file?") from None
        return cls(path, text, parse_policy(text, str(path)))

    def replace(self, text: str) -> "PolicyFile":
        """Replace the text, which is checked first: a policy with mistakes is never written.

        Raises:
            PolicyRefused: with all its mistakes.
            ConfigurationError: the file was changed meanwhile; it is not written.
        """
        policy = parse_policy(text, str(self.path))
        with files.locked_directory(self.path.parent):
            if self.path.exists():  # otherwise it is a new file
                self.check_unchanged()
            # the target of a link
            files.replace(self.path.resolve(), text.encode(), 0o644, keep=True)
        return PolicyFile(self.path, text, policy)

    def check_unchanged(self) -> None:
        """Return if the file still has the text that was read.

        Raises:
            ConfigurationError: it was changed meanwhile.
        """
        gone = ConfigurationError(f"{self.path} is gone, nothing was done", "write a policy first")
        if files.read(self.path, MAX_SIZE, gone) != self.text.encode():
            raise ConfigurationError(
                f"{self.path} was changed while this command was running, nothing was done",
                "run the command again: it then uses the new policy",
            )

    def require_tests(self) -> None:
        """Return if every test in the policy holds.

        Raises:
            PolicyRefused: one does not.
        """
        from grants.policy.assertion_check import require_tests  # noqa: PLC0415 - few need it

        if self.policy.tests:
            require_tests(self.policy, layout_of)

    @property
    def decider(self) -> Decider:
        """The decider for this policy."""
        return Decider(self.policy)


def place(home: Path, given: Path | None) -> Path:
    """The path of the policy: as given, else next to the authority's key."""
    return given if given is not None else home / "ca" / NAME


def read_policy(home: Path, given: Path | None, *, signs: bool = False) -> PolicyFile:
    """The policy at its place; if it is in force or `signs`, no other user may have written it."""
    if given is None and not place(home, None).exists():
        AuthorityHome.at(home)  # where there is none, that is the mistake
    return PolicyFile.read(place(home, given), own=signs or given is None)


def parse_policy(text: str, file: str) -> Policy:
    """Read a policy with the message types known here."""
    return load(text, definition_of, file=file, known_types=type_names())
