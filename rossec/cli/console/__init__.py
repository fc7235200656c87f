"""`rossec console`: the pages, and the phones that approve."""
