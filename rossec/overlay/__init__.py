"""Links between sites: relays carry sealed bytes through routers that learn nothing of them."""
