"""Manual pages, made of the commands themselves when the wheel is built (docs/decisions/0046)."""
