"""The border router of constrained things. Reserved: nothing is here yet."""
