"""Finding the master of one's own trust domain on the local link, without configuration."""

from rossec.discovery.announcement import Candidate, Candidates
from rossec.discovery.local_links import (
    PATIENCE,
    announce,
    discover_master,
    listening,
    masters,
    trusted,
    uri_of,
)

__all__ = [
    "PATIENCE",
    "Candidate",
    "Candidates",
    "announce",
    "discover_master",
    "listening",
    "masters",
    "trusted",
    "uri_of",
]
