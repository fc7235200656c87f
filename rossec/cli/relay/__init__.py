"""`rossec relay`: the links of a site with others, and whom it has them with."""
