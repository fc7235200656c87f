"""The main job as a story one can watch: `rossec demo`. Every step is the real thing."""
