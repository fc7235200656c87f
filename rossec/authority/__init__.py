"""The authority at work: its home, signing, approvals, renewals, backups."""
