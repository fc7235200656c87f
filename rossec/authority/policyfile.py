"""The policy of an authority: where it lies, and how it is read with the message types known here.

A shell around `grants.policy.read`. By default the file is `policy.yaml` beside the authority's
key; without one there is no policy, and nobody gets anything by it.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Final, Self

from grants.filters.layout import Layout, parse
from grants.policy.decision import Decider
from grants.policy.model import Policy
from grants.policy.read import load
from grants.policy.source import MAX_SIZE
from rossec import files
from rossec.errors import ConfigurationError
from rossec.participant.message_types import message_type, type_names

NAME: Final = "policy.yaml"


@dataclass(frozen=True)
class PolicyFile:
    """A policy with its text and its place."""

    path: Path
    text: str
    policy: Policy

    @classmethod
    def read(cls, path: Path, *, own: bool = False) -> Self:
        """Read the policy in `path`; with `own`, only if nobody else can write it.

        Raises:
            ConfigurationError: there is no such file, or it is no text.
            PathRefused: somebody else could have written it.
            PolicyRefused: with all its mistakes.
        """
        missing = ConfigurationError(
            f"there is no policy in {path}", "write one, or: rossec policy learn --from-graph"
        )
        try:
            text = (
                files.read_own(path, MAX_SIZE, missing, link=True)
                if own else files.read(path, MAX_SIZE, missing)
            ).decode()  # fmt: skip
        except UnicodeDecodeError:
            raise ConfigurationError(f"{path} is not UTF-8", "is it the right file?") from None
        return cls(path, text, parse_policy(text, str(path)))

    def replace(self, text: str) -> "PolicyFile":
        """Write another text, which is read first: a policy with mistakes is never written.

        Raises:
            PolicyRefused: with all its mistakes.
            ConfigurationError: somebody else has changed the file; it is not touched.
        """
        policy = parse_policy(text, str(self.path))
        with files.locked_directory(self.path.parent):
            if self.path.exists():  # else it is a new one
                self.check_unchanged()
            files.replace(self.path.resolve(), text.encode(), 0o644)  # behind a link
        return PolicyFile(self.path, text, policy)

    def check_unchanged(self) -> None:
        """Return if the file still says what was read: what was decided by it may be done.

        Raises:
            ConfigurationError: somebody else has changed it.
        """
        gone = ConfigurationError(f"{self.path} is gone, nothing was done", "write a policy first")
        if files.read(self.path, MAX_SIZE, gone) != self.text.encode():
            raise ConfigurationError(
                f"{self.path} was changed while this command was at work, nothing was done",
                "run the command again: it then goes by what the file says now",
            )

    @property
    def decider(self) -> Decider:
        """Decides by it."""
        return Decider(self.policy)


def place(home: Path, given: Path | None) -> Path:
    """Where the policy is: as given, else beside the authority's key."""
    return given if given is not None else home / "ca" / NAME


def parse_policy(text: str, file: str) -> Policy:
    """Read a policy with the message types known here."""
    return load(text, definition, file=file, known_types=type_names())


def definition(type_name: str) -> str:
    """The definition text of a message type."""
    return message_type(type_name).definition


def layout_of(type_name: str) -> Layout:
    """The layout of a message type."""
    return parse(type_name, definition(type_name))
