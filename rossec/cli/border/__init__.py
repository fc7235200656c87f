"""`rossec border`: run the border router, and its things."""
