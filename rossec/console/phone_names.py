"""Names of phones: what a person calls the device that approves. Pure."""

from typing import Final

MAX_NAME: Final = 40
"""Characters: it is shown in one line."""
