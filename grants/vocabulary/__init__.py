"""What the fields of messages tell in the words of people, and how coarse each level is."""
