"""Foreign trust domains: which are listed, who of them is admitted, and what is known of them."""
