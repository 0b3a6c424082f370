"""The stages of the pipeline: thin modules that load, call the library and save."""
