"""`rossec router`: a router between sites, and the seats at it."""
