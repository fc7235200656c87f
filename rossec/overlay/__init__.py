"""Links between sites. Reserved: nothing is here yet."""
