"""Masters of masters, and the gateway of a site. Reserved: nothing is here yet."""
