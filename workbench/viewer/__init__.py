"""The model in a browser: a static site, and serving it to the people at this machine."""
