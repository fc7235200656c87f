"""Approvals by passkey: what is approved, and the proof of it. Pure."""
