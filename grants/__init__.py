"""What a node may do: rights over names, conditions on messages, field filters, decisions."""
