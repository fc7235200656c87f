"""Names by rules: the namespace service. Reserved: nothing is here yet."""
