"""Pictures as SVG with classes: pure functions from views and samples to elements."""
