"""The main job, step by step: `rossec demo`. Every step is real."""
