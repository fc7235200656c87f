"""Codes read from a browser's pictures: in a process without rights, which the supervisor starts.

The web process sends a picture over a socketpair (`client`), the supervisor (`supervisor`) hands it
to a worker (`worker`) and ends one that takes too long. Neither of the two decodes anything.
"""
